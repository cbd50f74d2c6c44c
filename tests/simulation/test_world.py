"""The simulated bench: its random draws, the effect of hands and axes, its memory, and what a phantom adds."""

import itertools
import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from labrig.devices.rig_file import load_rig
from labrig.errors import InputError, MeasurementRefusedError
from labrig.experiments.declared import PROTOCOL_MODELS
from labrig.protocol.load import load_protocol
from labrig.simulation.description import DesignDescription, NeedleDescription, WorldDescription
from labrig.simulation.gel import Ball, GelBlock, draw_needle_scale, interpolate_radius_mm, make_hole
from labrig.simulation.world import World
from labrig.vision.plane import PlaneMap
from labrig.vision.sheath import measure_sheath
from tests.simulation.benches import (
    QUIET,
    SMALL_LENS,
    STILL_SHEATH,
    before_gel,
    bench,
    centre_line_mm,
    insert,
    one_radius,
    withdraw,
)

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize(("gelatin_percent", "mean", "sd"), [(10.0, 28.34, 0.247), (19.0, 27.13, 0.473)])
def test_radii_have_the_paper_s_mean_and_spread(gelatin_percent: float, mean: float, sd: float) -> None:
    """Over 1000 seeds mean and SD agree with section V-B within four standard errors."""
    block = GelBlock("A", gelatin_percent, 0, 0)
    drawn = np.array([make_hole(QUIET, seed, block, (3, 65.0), "N1").radius_mm for seed in range(1000)])
    assert abs(drawn.mean() - mean) < 4 * sd / np.sqrt(1000)
    assert abs(drawn.std(ddof=1) - sd) < 4 * sd / np.sqrt(2 * 1000)


def test_hole_specimen_needle_and_seed_each_change_the_draw() -> None:
    """Five holes that differ in one thing each have five radii; which holes were visited before does not matter."""
    worlds = [bench(), bench(hole=1), bench(seed=6)]
    for needle, name in (("N2", "A"), ("N1", "B")):
        worlds.append(world := World(QUIET, 5))
        world.mount_needle(needle)
        world.place_specimen(name, 13.0)
        world.shift_to_hole(name, 0, 35.0)
    assert len({world.truth()["radius_mm"] for world in worlds}) == 5
    after_others = bench(hole=0, position_mm=35.0)
    for hole, position_mm in ((1, 45.0), (3, 65.0)):
        after_others.shift_to_hole("A", hole, position_mm)
    assert bench(hole=3, position_mm=65.0).truth() == after_others.truth()


def _designed(low_mm: float, high_mm: float) -> WorldDescription:
    """Return a quiet world whose needle was designed for a radius in between."""
    design = DesignDescription(radius_low_mm=low_mm, radius_high_mm=high_mm)
    return QUIET.model_copy(update={"needle": NeedleDescription(design=design)})


def test_a_design_scales_the_radii_of_the_gels() -> None:
    """A needle designed for 45 mm steers half as tight again as the paper's, designed for 30, in the same hole.

    Each needle has one draw a seed, the same in every hole, spread over the whole tolerance.
    """
    paper, wide = bench().truth()["radius_mm"], bench(_designed(45.0, 45.0)).truth()["radius_mm"]
    assert isinstance(paper, float)
    assert wide == pytest.approx(1.5 * paper)
    assert bench(_designed(30.0, 30.0)).truth() == bench().truth()
    world = _designed(27.0, 33.0)
    scales = [draw_needle_scale(world, 5, f"N{number}") for number in range(200)]
    assert 27.0 / 30 < min(scales) < 27.3 / 30
    assert 32.7 / 30 < max(scales) < 33.0 / 30
    assert draw_needle_scale(world, 5, "N1") == scales[1] != draw_needle_scale(world, 6, "N1")
    assert draw_needle_scale(QUIET, 5, "N1") == 1.0


GEL = {"gelatin_percent": 13, "radius_mean_mm": 27.0, "radius_sd_mm": 0.2}


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"gels": [GEL, GEL]}, "13 % follows 13 %"),
        ({"needle": {"diameter_mm": 2.2}}, r"2\.2 mm; must be below sheath.diameter_mm, 2 mm"),
        ({"layers": [{"until_mm": z, "radius_scale": 1} for z in (30, 20)]}, "20 mm follows 30 mm"),
        ({"disturbances": {"cavity_mm": [9.0, 4.0]}}, "must have the lower one first"),
        (
            {"markers": [{"marker_id": 50, "side_mm": 6, "position_mm": [-12, 25]}]},
            "DICT_4X4_50, .* are 0 to 49",
        ),
    ],
)
def test_a_world_that_cannot_be_is_refused(changes: dict[str, Any], words: str) -> None:
    """What does not fit is named with its limit."""
    with pytest.raises((ValueError, InputError), match=words):
        before_gel(balls=(), **changes)


def _session(seed: int) -> tuple[bytes, ...]:
    """Return the pictures of a short session."""
    description = WorldDescription.model_validate_json(json.dumps({"lens": SMALL_LENS}))
    world, pictures = bench(description, seed), list[bytes]()
    for act in (
        lambda: insert(world, 20.0), lambda: withdraw(world), lambda: world.shift_to_hole("A", 1, 45.0),
        lambda: world.lay_graph_paper(1.0), lambda: world.hold_board(0, 9, 6, 25.0),
    ):  # fmt: skip
        act()
        pictures.append(world.picture().tobytes())
    return tuple(pictures)


def test_the_same_seed_gives_the_same_pictures_byte_for_byte() -> None:
    """Two worlds with one seed and the same actions give the same pictures; another seed gives others."""
    first = _session(3)
    assert first == _session(3)
    assert all(ours != theirs for ours, theirs in zip(first, _session(4), strict=True))


def test_the_needle_withdraws_along_its_path_and_follows_it_again() -> None:
    """Turned while withdrawn, it follows its old path, and bends the other way only beyond it."""
    world = bench()
    insert(world, 20.0)
    first = centre_line_mm(world)
    for inserted_mm in (0.0, 20.0, 40.0, 20.0):
        world.advance(inserted_mm, math.pi, 15.0)
        if inserted_mm == 20.0:
            assert centre_line_mm(world) == pytest.approx(first, abs=1e-9)
        elif inserted_mm == 40.0:
            y, z = centre_line_mm(world)[-40:].T
            assert np.all(np.diff(np.diff(y) / np.diff(z)) > 0)


def test_a_hole_keeps_its_truth_and_its_track() -> None:
    """Radius, sheath tip, deepest tip and length stay true after the needle is withdrawn, and go into JSON.

    Back at an old hole of a specimen that was put away meanwhile, the needle follows the track that it cut there.
    """
    world = bench(QUIET.model_copy(update={"sheath": before_gel(sheath=STILL_SHEATH).description.sheath}))
    insert(world, 40.0)
    deepest = world.truth()
    withdraw(world)
    assert world.truth() == deepest == json.loads(json.dumps(deepest))
    assert deepest["sheath_tip_mm"] == [0.0, 0.0]
    assert deepest["arc_length_mm"] == 40.0
    assert (deepest["specimen"], deepest["gelatin_percent"], deepest["hole"]) == ("A", 13.0, 0)
    world.place_specimen("B", 16.0)
    world.place_specimen("A", 13.0)
    world.shift_to_hole("A", 0, 35.0)
    assert world.truth() == deepest


def test_a_needle_is_carried_along_its_path_by_the_linear_axis() -> None:
    """2 mm of linear axis with the needle out move its tip on by 2 mm of arc, and back again."""
    world = bench()
    insert(world, 20.0)
    world.advance(20.0, 0.0, 17.0)
    tip = centre_line_mm(world)[-1]
    assert world.truth()["arc_length_mm"] == pytest.approx(22.0)
    world.advance(20.0, 0.0, 13.0)
    assert len(centre_line_mm(world)) > 0
    world.advance(22.0, 0.0, 15.0)
    assert centre_line_mm(world)[-1] == pytest.approx(tip)


@pytest.mark.parametrize(("insertion_mm", "linear_mm"), [(5.0, 0.0), (0.0, 15.0)])
def test_the_gel_is_not_moved_with_the_instrument_in_it(insertion_mm: float, linear_mm: float) -> None:
    """Shifting the gel with needle or sheath in it is refused, with the depth."""
    world = bench()
    world.advance(insertion_mm, 0.0, linear_mm)
    for change in (
        lambda: world.shift_to_hole("A", 1, 45.0),
        lambda: world.place_specimen("B", 13.0),
        world.clear_bench,
        lambda: world.mount_needle("N2"),
    ):
        with pytest.raises(InputError, match=f"{insertion_mm + linear_mm:.1f} mm deep in A"):
            change()


def test_what_no_gel_has_is_refused() -> None:
    """A hole beside it, and a gelatin content outside the known ones; the edges are taken."""
    for position_mm, percent in ((0.0, 10.0), (240.0, 19.0)):
        bench().shift_to_hole("A", 0, position_mm)
        World(QUIET, 1).place_specimen("A", percent)
    for position_mm in (-1.0, 240.1, math.nan):
        with pytest.raises(InputError, match="0 to 240 mm"):
            bench().shift_to_hole("A", 0, position_mm)
    for percent in (9.9, 19.1):
        with pytest.raises(InputError, match=rf"{percent:g} % .* 10 to 19 %"):
            World(QUIET, 1).place_specimen("A", percent)


BALLS = (Ball((0.0, 10.0, 34.0), 6.0), Ball((0.0, -12.0, 68.0), 6.0))
TARGET_MM = (0.0, 4.0, 100.0)
RADIUS_MM = 100.0


def _phantom(seed: int = 3, disturbances: dict[str, float] | None = None, **changes: object) -> World:
    """Return a world with a phantom, of which only the named changes disturb the path."""
    values: dict[str, object] = {
        "gels": one_radius(RADIUS_MM),
        "needle": {"hinge_closing_mm": 0.01, "backlash_mm": 0.01},
        "sheath": STILL_SHEATH,
        "lens": SMALL_LENS,
        "disturbances": {"heading_deg_per_root_mm": 0, "curvature_fraction": 0, **(disturbances or {})},
    }
    world = before_gel(seed, BALLS, **values | changes)
    world.aim_at(TARGET_MM)
    return world


def _lean_deg(seed: int) -> float:
    """Return the angle out of the plane at which a sheath with a play of a degree leads the needle."""
    world = _phantom(seed, sheath=STILL_SHEATH | {"lean_play_sd_deg": 1.0})
    world.advance(20.0, 0.0, 15.0)
    return math.degrees(math.asin(world.tip_mm()[0] / 20.0))


def _slip(seed: int) -> float:
    """Return by which share of the insertion, the same all the way, the tip lags behind."""
    world, shares = _phantom(seed, {"slip_sd_fraction": 0.02}), []
    for depth_mm in (30.0, 60.0):
        world.advance(depth_mm, 0.0, 15.0)
        shares.append(1 - float(str(world.truth()["arc_length_mm"])) / depth_mm)
    assert shares[0] == pytest.approx(shares[1])
    assert shares[0] >= 0
    return shares[0]


def _shift_mm(seed: int) -> float:
    """Return what shifted obstacles add to the clearance."""
    clearances = []
    for shift_mm in (1.0, 0.0):
        world = _phantom(seed, obstacle_shift_sd_mm=shift_mm)
        world.advance(60.0, 0.0, 15.0)
        clearances.append(float(str(world.truth()["true_min_clearance_mm"])))
    return clearances[0] - clearances[1]


@pytest.mark.parametrize(
    ("draw", "sd"),
    [
        (lambda seed: _phantom(seed, sheath=STILL_SHEATH | {"x_play_sd_mm": 0.5}).tip_mm()[0], 0.5),
        (_lean_deg, 1.0),
        (_slip, 0.02),
        (_shift_mm, 1.0),
    ],
    ids=["place of the sheath", "lean of the sheath", "slip", "shift of the obstacles"],
)
def test_each_phantom_draws_with_the_described_spread(draw: Callable[[int], float], sd: float) -> None:
    """Over thirty phantoms."""
    assert np.sqrt(np.mean(np.square([draw(seed) for seed in range(30)]))) == pytest.approx(sd, rel=0.4)


def test_layers_bend_the_needle_at_their_own_radius() -> None:
    """Between two layers the path turns by length over the radius of each; plain gel beside has no layers."""
    layers = [{"until_mm": 15, "radius_scale": 0.8}, {"until_mm": 25, "radius_scale": 1.2}]
    plain = [before_gel(layers=those, lens=SMALL_LENS) for those in ([], layers)]
    for world in plain:
        world.advance(40.0, 0.0, 15.0)
    assert plain[0].tip_mm() == plain[1].tip_mm()
    world = _phantom(layers=layers)
    world.advance(40.0, 0.0, 15.0)
    line = centre_line_mm(world, 2001)
    curvatures = -np.gradient(np.arctan2(*np.diff(line, axis=0).T)) / 0.02
    for z_mm, scale in ((8.0, 0.8), (20.0, 1.2), (27.0, 1.0)):
        index = int(np.argmin(np.abs(line[:, 1] - z_mm)))
        assert 1 / curvatures[index] == pytest.approx(scale * RADIUS_MM, rel=0.01)


def test_the_target_moves_with_the_tip_and_does_not_move_back() -> None:
    """Half-way it has moved by half, at the end by all of it, and a withdrawn needle leaves it there."""
    world = _phantom(target_moves_mm=3.0)
    moved = []
    for depth_mm in (0.0, 50.0, 110.0, 0.0):
        for step in range(20):
            world.advance(depth_mm, math.pi * (step % 2), 15.0)
        target = world.locate_target_mm()
        assert target is not None
        assert target[0] == 0.0
        moved.append(math.dist(target, TARGET_MM))
    assert moved == pytest.approx([0.0, 3.0 * 50.0 / math.hypot(*TARGET_MM), 3.0, 3.0])
    truth: Any = world.truth()
    tip_mm = (truth["tip_x_mm"], *truth["tip_mm"])
    assert truth["target_mm"] == pytest.approx(target)
    assert truth["true_target_error_mm"] == pytest.approx(math.dist(tip_mm, truth["target_mm"]))


def test_plain_gel_is_even_and_a_phantom_is_not() -> None:
    """The sweep's radii stay what they are; only phantoms are disturbed unless the description says otherwise."""
    tips = []
    for balls, everywhere in itertools.product((None, ()), (False, True)):
        world = before_gel(5, balls, disturbances={"in_every_gel": everywhere}, lens=SMALL_LENS)
        world.advance(40.0, 0.0, 15.0)
        tips.append(world.tip_mm())
    assert tips[0] != tips[1] == tips[2] == tips[3]


def test_truth_of_a_phantom_tells_the_clearance_over_the_whole_path() -> None:
    """From surface to surface."""
    world = _phantom()
    for depth_mm in range(1, 61):
        world.advance(float(depth_mm), 0.0, 15.0)
    truth: Any = world.truth()
    path = np.array(truth["path_mm"])
    apart = [np.linalg.norm(path - ball.position_mm, axis=1).min() - ball.radius_mm - 0.6 for ball in BALLS]
    assert truth["true_min_clearance_mm"] == pytest.approx(min(apart), abs=0.01)


@pytest.mark.parametrize("name", ["reference", "hard"])
def test_the_worlds_of_the_rig_files_are_not_what_the_protocol_assumes(name: str) -> None:
    """Neither radius, backlash nor closing length of the needle is the policy's own."""
    world = load_rig(ROOT / "calibration" / f"rig-{name}.yaml").world
    protocol: Any = load_protocol(ROOT / "protocols" / "insertion.yaml", PROTOCOL_MODELS)
    assert world is not None
    mean_mm, sd_mm = interpolate_radius_mm(world.gels, protocol.specimen.gelatin_percent)
    assert sd_mm > 0
    assert mean_mm != pytest.approx(protocol.planner.radius_mm, abs=0.1)
    assert world.needle.backlash_mm != pytest.approx(protocol.policy.backlash_mm, rel=0.1)
    assert world.needle.hinge_closing_mm != pytest.approx(protocol.policy.closing_mm, rel=0.1)


@pytest.mark.parametrize(("seed", "hole"), [(10, 0), (48, 1)])
def test_a_bubble_before_the_sheath_refuses_no_run(seed: int, hole: int) -> None:
    """In these worlds one touches the end: the tip is found all the same, and not of a sheath that the needle left."""
    world = World(load_rig(ROOT / "calibration" / "rig-simulated.yaml").world, seed)
    world.mount_needle("N1")
    world.place_specimen("A", 10.0 + seed % 10)
    world.shift_to_hole("A", hole, 8.0 + 8.0 * hole)
    world.advance(0.0, 0.0, 15.0)
    plane = PlaneMap.from_scale(9.49, (150.0, 310.0), "right", (1280, 720))
    found = measure_sheath(world.picture(), plane, 2.0)
    assert found.tip_mm == pytest.approx(world.sheath_point_mm()[1:], abs=0.2)
    world.advance(3.0, 0.0, 15.0)
    with pytest.raises(MeasurementRefusedError, match="0 of 21 stripes"):
        measure_sheath(world.picture(), plane, 2.0)
