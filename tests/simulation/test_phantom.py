"""What a phantom adds to plain gel: obstacles, disturbances, layers, and a target that moves."""

import itertools
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from labrig.devices.rig_file import load_rig
from labrig.experiments.declared import PROTOCOL_MODELS
from labrig.protocol.load import load_protocol
from labrig.simulation.gel import Ball, interpolate_radius_mm
from labrig.simulation.world import World
from tests.simulation.benches import SMALL_LENS, STILL_SHEATH, before_gel, centre_line_mm, one_radius

ROOT = Path(__file__).parents[2]
BALLS = (Ball((0.0, 10.0, 34.0), 6.0), Ball((0.0, -12.0, 68.0), 6.0))
TARGET_MM = (0.0, 4.0, 100.0)
RADIUS_MM = 100.0


def phantom(seed: int = 3, disturbances: dict[str, float] | None = None, **changes: object) -> World:
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


def find_lean_deg(seed: int) -> float:
    """Return the angle out of the plane at which a sheath with a play of a degree leads the needle."""
    world = phantom(seed, sheath=STILL_SHEATH | {"lean_play_sd_deg": 1.0})
    world.advance(20.0, 0.0, 15.0)
    return math.degrees(math.asin(world.tip_mm()[0] / 20.0))


def find_slip(seed: int) -> float:
    """Return by which share of the insertion, the same all the way, the tip lags behind."""
    world, shares = phantom(seed, {"slip_sd_fraction": 0.02}), []
    for depth_mm in (30.0, 60.0):
        world.advance(depth_mm, 0.0, 15.0)
        shares.append(1 - float(str(world.truth()["arc_length_mm"])) / depth_mm)
    assert shares[0] == pytest.approx(shares[1])
    assert shares[0] >= 0
    return shares[0]


def find_shift_mm(seed: int) -> float:
    """Return what shifted obstacles add to the clearance."""
    clearances = []
    for shift_mm in (1.0, 0.0):
        world = phantom(seed, obstacle_shift_sd_mm=shift_mm)
        world.advance(60.0, 0.0, 15.0)
        clearances.append(float(str(world.truth()["true_min_clearance_mm"])))
    return clearances[0] - clearances[1]


@pytest.mark.parametrize(
    ("draw", "sd"),
    [
        (lambda seed: phantom(seed, sheath=STILL_SHEATH | {"x_play_sd_mm": 0.5}).tip_mm()[0], 0.5),
        (find_lean_deg, 1.0),
        (find_slip, 0.02),
        (find_shift_mm, 1.0),
    ],
    ids=["place of the sheath", "lean of the sheath", "slip", "shift of the obstacles"],
)
def test_each_phantom_draws_with_the_described_spread(draw: Callable[[int], float], sd: float) -> None:
    """Over thirty phantoms."""
    assert np.sqrt(np.mean(np.square([draw(seed) for seed in range(30)]))) == pytest.approx(sd, rel=0.4)


def test_layers_bend_the_needle_at_their_own_radius() -> None:
    """Between two layers the path turns by length over the radius of each; plain gel beside has no layers."""
    world = phantom(layers=[{"until_mm": 15, "radius_scale": 0.8}, {"until_mm": 25, "radius_scale": 1.2}])
    world.advance(40.0, 0.0, 15.0)
    line = centre_line_mm(world, 2001)
    headings = np.arctan2(*np.diff(line, axis=0).T)
    curvatures = -np.gradient(headings) / 0.02
    for z_mm, scale in ((8.0, 0.8), (20.0, 1.2), (27.0, 1.0)):
        index = int(np.argmin(np.abs(line[:, 1] - z_mm)))
        assert 1 / curvatures[index] == pytest.approx(scale * RADIUS_MM, rel=0.01)


def test_the_target_moves_with_the_tip_and_does_not_move_back() -> None:
    """Half-way it has moved by half, at the end by all of it, and a withdrawn needle leaves it there."""
    world = phantom(target_moves_mm=3.0)
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
    world = phantom()
    for depth_mm in range(1, 61):
        world.advance(float(depth_mm), 0.0, 15.0)
    truth: Any = world.truth()
    path = np.array(truth["path_mm"])
    apart = [np.linalg.norm(path - ball.centre_mm, axis=1).min() - ball.radius_mm - 0.6 for ball in BALLS]
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
