"""What a hard world adds: a sheath out of the plane, slip, layers, shifted obstacles, a target that moves."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from labrig.devices.rig_file import load_rig
from labrig.experiments.declared import PROTOCOL_MODELS
from labrig.protocol.load import load_protocol
from labrig.simulation.description import WorldDescription
from labrig.simulation.gel import Ball, interpolate_radius_mm
from labrig.simulation.world import World
from tests.simulation.benches import centre_line_mm

ROOT = Path(__file__).parents[2]
NO_WANDER = {"heading_deg_per_root_mm": 0, "curvature_fraction": 0}
STILL_SHEATH = {"lateral_play_sd_mm": 0, "angle_play_sd_deg": 0}
BALLS = (Ball((0.0, 10.0, 34.0), 6.0), Ball((0.0, -12.0, 68.0), 6.0))
TARGET_MM = (0.0, 4.0, 100.0)
RADIUS_MM = 100.0
SMALL_LENS = {"width_px": 64, "height_px": 64, "cx_px": 32, "cy_px": 32, "origin_px": [32, 32]}


def phantom(seed: int = 3, disturbances: dict[str, float] | None = None, **changes: object) -> World:
    """Return a world with a phantom, of which only the named changes disturb the path, the sheath introduced."""
    values: dict[str, Any] = {
        "gels": [{"gelatin_percent": 13, "radius_mean_mm": RADIUS_MM, "radius_sd_mm": 0}],
        "needle": {"hinge_closing_mm": 0.01, "backlash_mm": 0.01},
        "sheath": STILL_SHEATH,
        "bubbles_per_specimen": 0,
        "lens": SMALL_LENS,
        "disturbances": NO_WANDER | (disturbances or {}),
    }
    world = World(WorldDescription.model_validate_json(json.dumps(values | changes)), seed)
    world.mount_needle("N1")
    world.place_phantom("block", 13.0, BALLS)
    world.aim_at(TARGET_MM)
    world.advance(0.0, 0.0, 15.0)
    return world


def test_a_sheath_out_of_the_plane_starts_the_path_there() -> None:
    """Place and lean have the described spread from phantom to phantom, and a straight start leaves along the lean."""
    sheath = STILL_SHEATH | {"x_play_sd_mm": 0.5, "lean_play_sd_deg": 1.0}
    places, leans = [], []
    for seed in range(30):
        world = phantom(seed, sheath=sheath)
        places.append(world.tip_mm()[0])
        world.advance(20.0, 0.0, 15.0)
        leans.append(math.degrees(math.asin((world.tip_mm()[0] - places[-1]) / 20.0)))
    assert np.std(places) == pytest.approx(0.5, rel=0.3)
    assert np.std(leans) == pytest.approx(1.0, rel=0.3)


def test_the_tip_lags_behind_by_a_share_of_the_insertion() -> None:
    """The share is the same all the way, never negative, and of the described size."""
    shares = []
    for seed in range(30):
        world = phantom(seed, {"slip_sd_fraction": 0.02})
        world.advance(30.0, 0.0, 15.0)
        share = 1 - float(str(world.truth()["arc_length_mm"])) / 30.0
        world.advance(60.0, 0.0, 15.0)
        assert world.truth()["arc_length_mm"] == pytest.approx(60.0 * (1 - share))
        shares.append(share)
    assert min(shares) >= 0
    assert np.sqrt(np.mean(np.square(shares))) == pytest.approx(0.02, rel=0.3)


def test_layers_bend_the_needle_at_their_own_radius() -> None:
    """Between two layers the path turns by length over the radius of each; plain gel beside has no layers."""
    layers = [{"until_mm": 15, "radius_scale": 0.8}, {"until_mm": 25, "radius_scale": 1.2}]
    world = phantom(layers=layers)
    world.advance(40.0, 0.0, 15.0)
    line = centre_line_mm(world, 2001)
    steps = np.diff(line, axis=0)
    headings = np.arctan2(steps[:, 0], steps[:, 1])
    curvatures = -np.gradient(headings) / 0.02
    for z_mm, scale in ((8.0, 0.8), (20.0, 1.2), (27.0, 1.0)):
        index = int(np.argmin(np.abs(line[:, 1] - z_mm)))
        assert 1 / curvatures[index] == pytest.approx(scale * RADIUS_MM, rel=0.01)
    plain = phantom()
    plain.advance(40.0, 0.0, 15.0)
    assert world.tip_mm() != plain.tip_mm()


def test_the_clearance_is_that_of_the_obstacles_where_they_are() -> None:
    """Shifted by the described spread along each axis, each phantom in its own way."""
    shifts = []
    for seed in range(30):
        world = phantom(seed, obstacle_shift_sd_mm=1.0)
        world.advance(60.0, 0.0, 15.0)
        still = phantom(seed)
        still.advance(60.0, 0.0, 15.0)
        shifted, true = (float(str(w.truth()["true_min_clearance_mm"])) for w in (world, still))
        shifts.append(shifted - true)
    assert np.std(shifts) == pytest.approx(1.0, rel=0.4)


def test_the_target_moves_with_the_tip_and_does_not_move_back() -> None:
    """Half-way it has moved by half, at the end by all of it, and a withdrawn needle leaves it there."""
    world = phantom(target_moves_mm=3.0)
    moved = []
    for depth_mm in (0.0, 50.0, 110.0, 0.0):
        for step in range(20):
            world.advance(depth_mm, math.pi * (step % 2), 15.0)
        target = world.locate_target_mm()
        assert target is not None
        moved.append(math.dist(target, TARGET_MM))
        assert target[0] == 0.0
    way_mm = math.dist(TARGET_MM, (0.0, 0.0, 0.0))
    assert moved == pytest.approx([0.0, 3.0 * 50.0 / way_mm, 3.0, 3.0])
    truth: Any = world.truth()
    assert truth["target_mm"] == pytest.approx(world.locate_target_mm())
    assert truth["true_target_error_mm"] == pytest.approx(
        math.dist((truth["tip_x_mm"], *truth["tip_mm"]), truth["target_mm"])
    )


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
