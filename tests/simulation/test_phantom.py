"""What disturbs a path, and blocks with obstacles cast in."""

import itertools
import json
import math

import numpy as np
import pytest

from labrig.simulation.description import DisturbancesDescription, WorldDescription
from labrig.simulation.gel import Ball
from labrig.simulation.track import EVEN, NODE_MM, Bending, Track, Unevenness, draw_unevenness
from labrig.simulation.world import World

BENDING = Bending(28.0, 3.0, 1.5)
SEEDS = range(200)


def disturbances(**changes: object) -> DisturbancesDescription:
    """Return disturbances of one kind only."""
    none = {"heading_deg_per_root_mm": 0.0, "curvature_fraction": 0.0}
    return DisturbancesDescription.model_validate({**none, **changes})


def draw_path(description: DisturbancesDescription, seed: int) -> Unevenness:
    """Return what is drawn for a path."""
    return draw_unevenness(description, np.random.default_rng(seed))


def phantom(seed: int = 3, *balls: Ball, **changes: object) -> World:
    """Return a world with a needle before a phantom, and the sheath introduced."""
    values = {"noise_sd": 0.0, "bubbles_per_specimen": 0, "disturbances": changes}
    world = World(WorldDescription.model_validate_json(json.dumps(values)), seed)
    world.mount_needle("N1")
    world.place_phantom("block", 13.0, balls)
    world.advance(0.0, 0.0, 15.0)
    return world


def test_the_heading_wanders_with_the_root_of_the_length() -> None:
    """Over 200 paths the heading's spread is 0.3 degrees after 1 mm and 3 degrees after 100 mm."""
    turns = np.array([draw_path(disturbances(heading_deg_per_root_mm=0.3), seed).turn_rad for seed in SEEDS])
    for length_mm, expected_deg in ((1.0, 0.3), (100.0, 3.0)):
        spread = np.degrees(turns[:, : round(length_mm / NODE_MM)].sum(axis=1)).std()
        assert spread == pytest.approx(expected_deg, rel=0.2)


def test_the_curvature_wanders_about_its_mean_and_forgets() -> None:
    """Its share has the given spread, and a correlation of 1/e after the given length."""
    description = disturbances(curvature_fraction=0.05, curvature_length_mm=10.0)
    off = np.array([draw_path(description, seed).curvature_share for seed in SEEDS]) - 1.0
    assert off.std() == pytest.approx(0.05, rel=0.1)
    later = off[:, round(10.0 / NODE_MM) :]
    correlation = np.mean(off[:, : later.shape[1]] * later) / off.var()
    assert correlation == pytest.approx(math.exp(-1.0), abs=0.05)


def test_a_needle_does_not_steer_in_a_cavity() -> None:
    """Once the hinges have given way the path is straight, and behind the cavity it bends again."""
    share = np.ones_like(EVEN.curvature_share)
    share[round(10.0 / NODE_MM) : round(18.0 / NODE_MM)] = 0.0
    track = Track((0.0, 0.0), 0.0, BENDING, EVEN._replace(curvature_share=share.tolist()))
    track.extend(30.0, 0.0)
    headings = [track.node_at(arc).heading_rad for arc in (11.0, 18.0, 20.0, 25.0)]
    assert headings[0] == pytest.approx(headings[1], abs=1e-12)
    assert headings[2] - headings[3] == pytest.approx(5.0 / 28.0)


def test_a_bevel_on_its_way_round_leads_out_of_the_plane() -> None:
    """A millimetre at a quarter turn leans the path by 1/r towards +x, as equation 5 says."""
    track = Track((0.0, 0.0), 0.0, BENDING)
    track.extend(20.0, math.pi / 2)
    end = track.node_at(20.0)
    assert end.lean_rad == pytest.approx((20.0 - 1.5) / 28.0, abs=1e-9)
    assert end.x_mm > 0
    assert end.heading_rad == pytest.approx(0.0, abs=1e-12)


def test_plain_gel_is_even_and_a_phantom_is_not() -> None:
    """The sweep's radii stay what they are; only phantoms are disturbed unless the description says otherwise."""
    tips = []
    for place, everywhere in itertools.product(("gel", "phantom"), (False, True)):
        description = WorldDescription(disturbances=DisturbancesDescription(in_every_gel=everywhere))
        world = World(description, 5)
        world.mount_needle("N1")
        if place == "gel":
            world.place_specimen("A", 13.0)
        else:
            world.place_phantom("A", 13.0, ())
        world.advance(0.0, 0.0, 15.0)
        world.advance(40.0, 0.0, 15.0)
        tips.append(world.truth()["tip_mm"])
    assert tips[0] != tips[1] == tips[2] == tips[3]


def test_truth_of_a_phantom_tells_error_and_clearance() -> None:
    """Error from tip to target in space; clearance from surface to surface over the whole path."""
    ball = Ball((0.0, 6.0, 20.0), 4.0)
    world = phantom(3, ball)
    world.aim_at((0.0, -5.0, 20.0))
    for depth_mm in range(1, 21):
        world.advance(float(depth_mm), 0.0, 15.0)
    truth = world.truth()
    path = np.array(truth["path_mm"])
    apart = np.linalg.norm(path - ball.centre_mm, axis=1).min() - 4.0 - 0.6
    assert truth["true_min_clearance_mm"] == pytest.approx(apart, abs=0.01)
    assert truth["true_target_error_mm"] == pytest.approx(math.dist(path[-1], (0.0, -5.0, 20.0)), abs=1e-3)


def test_an_obstacle_is_seen_where_it_is_and_the_gel_shines_through() -> None:
    """Its disc is darker than the gel about it, by less than half."""
    plain, cast = phantom(3).picture(), phantom(3, Ball((0.0, 0.0, 40.0), 5.0)).picture()
    changed = np.argwhere(np.abs(plain.astype(int) - cast) > 10)
    middle = changed.mean(axis=0)
    ratio = cast[tuple(middle.astype(int))] / plain[tuple(middle.astype(int))]
    assert 0.5 < ratio < 0.9
