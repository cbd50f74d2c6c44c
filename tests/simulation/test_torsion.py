"""Torsional play between the base of the needle and its bevel, and what it does to a path."""

import json
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from labrig.simulation.description import WorldDescription
from labrig.simulation.track import follow_with_play
from labrig.simulation.world import World

LENGTH_MM = 30.0
RADIUS_MM = 28.0

angles = st.lists(st.floats(-20.0, 20.0), min_size=1, max_size=30)


def bench(lag_deg: float, lag_deg_per_mm: float = 0.0, clamp_roll_deg: float = 0.0) -> World:
    """Return a quiet world with this play and a needle of a known radius, the sheath introduced."""
    values = {
        "gels": [{"gelatin_percent": 13, "radius_mean_mm": RADIUS_MM, "radius_sd_mm": 0}],
        "sheath": {"lateral_play_sd_mm": 0, "angle_play_sd_deg": 0},
        "needle": {
            "hinge_closing_mm": 0.01,
            "backlash_mm": 0.01,
            "torsion_lag_deg": lag_deg,
            "torsion_lag_deg_per_mm": lag_deg_per_mm,
            "clamp_roll_deg": clamp_roll_deg,
        },
        "bubbles_per_specimen": 0,
        "lens": {"width_px": 64, "height_px": 64, "cx_px": 32, "cy_px": 32, "origin_px": [32, 32]},
    }
    world = World(WorldDescription.model_validate_json(json.dumps(values)), 1)
    world.mount_needle("N1")
    world.place_specimen("block", 13.0)
    world.advance(0.0, 0.0, 15.0)
    return world


def insert(world: World, pieces: list[tuple[float, float]]) -> float:
    """Insert to each length at each roll, turning while the needle stands, and return the tip's x."""
    at_mm = 0.0
    for to_mm, roll_rad in pieces:
        world.advance(at_mm, roll_rad, 15.0)
        world.advance(to_mm, roll_rad, 15.0)
        at_mm = to_mm
    return world.tip_mm()[0]


@given(bases=angles, lag_rad=st.floats(0.0, 1.0), parts=st.integers(1, 20))
def test_the_bevel_follows_the_base_with_play(bases: list[float], lag_rad: float, parts: int) -> None:
    """Within the lag, only when it must, and however finely a turn is sampled; without play it is where the base is."""
    bevel = base = 0.0
    for to in bases:
        finely = bevel
        for part in range(1, parts + 1):
            finely = follow_with_play(finely, base + (to - base) * part / parts, lag_rad)
        before, bevel, base = bevel, follow_with_play(bevel, to, lag_rad), to
        assert abs(bevel - to) <= lag_rad + 1e-12
        assert bevel == before or abs(bevel - to) == pytest.approx(lag_rad, abs=1e-12)
        assert bevel == pytest.approx(finely, abs=1e-12)
        assert follow_with_play(before, to, 0.0) == to


def test_turning_to_and_fro_bends_out_of_the_plane_on_one_side() -> None:
    """Behind by the lag at both sides, the needle leans on towards +x: x grows as sin(lag) / r times s^2 / 2."""
    bend = math.sin(math.radians(10.0)) / RADIUS_MM
    x_mm = insert(bench(10.0), [(10.0, 0.0), (20.0, math.pi), (30.0, 0.0), (40.0, math.pi)])
    assert x_mm == pytest.approx(bend * 30.0**2 / 2, rel=0.02)


def test_turning_on_the_same_way_lets_the_sides_cancel() -> None:
    """Each half turn leaves the bevel behind on the other side, so that the lean comes back to zero."""
    bend = math.sin(math.radians(10.0)) / RADIUS_MM
    x_mm = insert(bench(10.0), [(10.0, 0.0), (20.0, math.pi), (30.0, 2 * math.pi), (40.0, 3 * math.pi)])
    assert x_mm == pytest.approx(bend * (50.0 + 50.0 + 50.0), rel=0.02)


def test_the_wind_up_stays_while_the_needle_waits_and_while_it_advances() -> None:
    """The bevel keeps the lag of the length at which it was turned, however deep it goes and however long it waits."""
    world = bench(0.0, lag_deg_per_mm=0.5)
    insert(world, [(10.0, 0.0)])
    for _ in range(50):
        world.advance(10.0, math.pi, 15.0)
    world.advance(40.0, math.pi, 15.0)
    bend = math.sin(math.radians(0.5 * 10.0)) / RADIUS_MM
    assert world.tip_mm()[0] == pytest.approx(bend * 30.0**2 / 2, rel=0.02)


def test_overshooting_by_the_lag_and_returning_leaves_the_bevel_in_the_plane() -> None:
    """Turned on by the lag, the bevel is on its side, and stays there while the base returns to it."""
    lag_rad = math.radians(10.0)
    for base_rad in (math.pi + lag_rad, math.pi):
        world = bench(10.0)
        insert(world, [(10.0, 0.0)])
        world.advance(10.0, math.pi + lag_rad, 15.0)
        assert insert(world, [(10.0, base_rad), (40.0, base_rad)]) == pytest.approx(0.0, abs=1e-9)
