"""One virtual insertion: the steering loop against the simulated world, without pictures, bus and record.

It is the first insertion that a run of the protocol on a simulated rig makes, in the same world: what is drawn for a
seed is the same. Axes, calibration, roll zero and torsion are those of the rig file and its state. Conditions
(`ask_when`, `stop_when`) and graph paper before and after are left out.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from labrig.analysis.origin import compare_with_command
from labrig.analysis.outcome import TaskOutcome
from labrig.devices.needle_state import NeedleState, RollZero
from labrig.devices.rig_file import RigDescription
from labrig.errors import FileFormatError, InputError, MeasurementRefusedError, TargetMissedError
from labrig.experiments.insertion.aim import (
    Aim,
    PickedPlaces,
    find_aim_problems,
    locate_stated_obstacles,
    make_aim,
)
from labrig.experiments.insertion.bevel_path import BevelPath
from labrig.experiments.insertion.marker_view import find_target_sd_mm
from labrig.experiments.insertion.plan import make_roll_zero_order
from labrig.experiments.insertion.protocol import InsertionProtocol
from labrig.experiments.insertion.settings import make_insertion_settings, make_out_of_plane, with_start
from labrig.experiments.insertion.virtual_axis import VirtualAxis
from labrig.experiments.insertion.virtual_camera import CalibratedCamera
from labrig.experiments.insertion.virtual_insertion import VirtualEnd, VirtualInsertion, end_insertion
from labrig.experiments.insertion.virtual_roll_zero import search_roll_zero
from labrig.experiments.shared.rig_view import load_plane_map
from labrig.experiments.shared.roll_zero_search import RollZeroOrder
from labrig.simulation.gel import Ball
from labrig.simulation.seeds import stream
from labrig.simulation.world import World
from labrig.steering.policy import SteeringCommand, SteeringSettings
from labrig.steering.state import SteeringState
from labrig.steering.step import start_steering
from labrig.steering.torsion import BaseLimits
from labrig.vision.plane import PlaneMap

_NO_VALUES: Mapping[str, float | bool | None] = dict.fromkeys(
    (
        "true_target_error_mm",
        "true_in_plane_error_mm",
        "true_out_of_plane_mm",
        "true_min_clearance_mm",
        "target_error_mm",
        "target_error_low_mm",
        "target_error_high_mm",
        "reached",
        "replans",
        "turns",
        "length_mm",
        "target_x_mm",
        "target_y_mm",
        "target_z_mm",
    )
)
"""The values of an insertion that was not made.

`true_` is the world's truth: the distance from the target in space, in the plane and across it, and the least clearance
of an obstacle. `target_error_mm` and its interval are what the last picture tells. `target_` is where the target was
told to be.
"""


def simulate(protocol: InsertionProtocol, rig: RigDescription | None, seed: int) -> TaskOutcome:
    """Return what comes of one insertion; the same seed gives the same bits in any process.

    Its roll zero is the one that is certified for the rig, else found as the protocol says.

    Raises
    ------
    InputError
        For a rig without a simulated world or without a plane map, and for what only pictures tell: markers, and a
        torsion to be measured.
    FileFormatError
        For a target or an obstacle where none can be.
    """
    if rig is None or rig.world is None:
        raise InputError(
            "an insertion is simulated in the world of a simulated rig, and there is none",
            "name a rig file of kind simulated",
        )
    if protocol.markers is not None:
        raise InputError(
            "markers are followed in pictures, and a virtual run has none",
            "make whole runs on a simulated rig, or leave out markers",
        )
    try:
        return _describe(_insert(protocol, _Scene.of(protocol, rig.with_needle(protocol.needle), seed)))
    except TargetMissedError as error:
        return TaskOutcome("failed", error.reason, _NO_VALUES)
    except MeasurementRefusedError as error:
        return TaskOutcome("failed", error.message, _NO_VALUES)


@dataclass(frozen=True)
class _Scene:
    """A rig whose needle is mounted, its world and camera, its roll zero, and where the rotation axis stands."""

    rig: RigDescription
    world: World
    camera: CalibratedCamera
    roll_zero: RollZero
    rotation_rad: float

    @classmethod
    def of(cls, protocol: InsertionProtocol, rig: RigDescription, seed: int) -> "_Scene":
        assert rig.world is not None
        world = World(rig.world, seed)
        world.mount_needle(protocol.needle.needle_id)
        camera = CalibratedCamera(rig.world.lens, load_plane_map(rig), stream(seed, "sightings"))
        certified = NeedleState(rig.state_path).recall_roll_zero(protocol.needle.needle_id)
        if certified is not None:
            return cls(rig, world, camera, certified, 0.0)
        order = _order_search(protocol)
        return cls(rig, world, camera, search_roll_zero(order, world, camera), order.farthest_roll_rad)


@dataclass(frozen=True)
class _Made:
    """An insertion that was made, towards its aim, and its end."""

    insertion: VirtualInsertion
    aim: Aim
    end: VirtualEnd


def _order_search(protocol: InsertionProtocol) -> RollZeroOrder:
    """Return how the roll zero is found. Raises `TargetMissedError` when the protocol does not say it."""
    if protocol.roll_zero is None:
        raise TargetMissedError(
            f"needle {protocol.needle.needle_id} has no certified roll zero",
            "say how to find it under roll_zero: in the protocol",
            reason="no_roll_zero",
        )
    return make_roll_zero_order(protocol, protocol.roll_zero)


def _insert(protocol: InsertionProtocol, scene: _Scene) -> _Made:
    """Place the block, plan, insert, and look at the end."""
    world, camera, roll_zero = scene.world, scene.camera, scene.roll_zero
    aim = _find_aim(protocol, scene)
    settings, state, command = _plan_from_origin(protocol, aim)
    if command.stop is not None:
        raise TargetMissedError(
            f"there is no path: {command.detail}", "move target or obstacles", reason="no_path"
        )
    axes = scene.rig.axes
    bevel = BevelPath(
        trial=0,
        zero_rad=roll_zero.zero_rad,
        lag=roll_zero.lag,
        limits=BaseLimits.of_axis(axes.rotation.limits, roll_zero.zero_rad),
        turning=protocol.policy.turning,
        radius_mm=protocol.planner.radius_mm,
    )
    made = VirtualInsertion(
        world=world,
        camera=camera,
        axis=VirtualAxis(axes.insertion, 1.0 / scene.rig.recording.state_rate_hz),
        bevel=bevel,
        settings=settings,
        speed_mm_s=protocol.insertion.speed_mm_s,
        linear_mm=protocol.sheath.depth_mm,
    )
    _centre(scene, bevel)
    made.move_world(0.0, 0.0)
    state, command = _start_from_sheath(protocol, made, camera, state, command)
    world.aim_at(_place_truly(world, camera.plane, aim.target_mm))
    state, command = made.steer(state, command)
    unseen = make_out_of_plane(protocol, roll_zero.sd_rad, roll_zero.torsion)
    target_sd_mm = find_target_sd_mm(protocol, None)
    return _Made(made, aim, end_insertion(made, state, command, unseen, target_sd_mm))


@lru_cache(maxsize=256)
def _plan_from_origin(
    protocol: InsertionProtocol, aim: Aim
) -> tuple[SteeringSettings, SteeringState, SteeringCommand]:
    """Return the settings and the first plan from the plane's origin; a campaign asks for the same one again."""
    settings = make_insertion_settings(protocol, aim.target_mm, aim.obstacles)
    return settings, *start_steering(settings)


def _find_aim(protocol: InsertionProtocol, scene: _Scene) -> Aim:
    """Place the block, and return target and obstacles as they are stated, or as the simulated operator names them."""
    world, plane = scene.world, scene.camera.plane
    balls = [
        Ball(_place_truly(world, plane, obstacle.position_mm), obstacle.radius_mm)
        for obstacle in locate_stated_obstacles(protocol, plane)
    ]
    world.place_phantom(protocol.specimen.name, protocol.specimen.gelatin_percent, balls)
    asked = [number for number, obstacle in enumerate(protocol.obstacles) if obstacle.ask]
    picked = PickedPlaces(
        world.target_mark_px() if protocol.target.ask else None,
        {number: world.obstacle_mark_px(count) for count, number in enumerate(asked)},
    )
    aim = make_aim(protocol, plane, picked)
    if problems := tuple(find_aim_problems(protocol, aim, plane)):
        raise FileFormatError(problems)
    return aim


def _place_truly(
    world: World, plane: PlaneMap, told_mm: tuple[float, float, float]
) -> tuple[float, float, float]:
    """Return where a place truly is that the map of the plane has elsewhere: a person puts it where it is seen."""
    u, v = plane.to_px(np.array([told_mm[1:]]))[0].tolist()
    return world.point_at_pixel_mm((u, v))


def _centre(scene: _Scene, bevel: BevelPath) -> None:
    """Turn the bevel to the roll zero while the needle is in the sheath."""
    if bevel.turning == "compensated":
        turn = bevel.centre(scene.rotation_rad - bevel.zero_rad)
        scene.world.advance(0.0, bevel.zero_rad + turn.farthest_rad, 0.0)
    scene.world.advance(0.0, bevel.zero_rad, 0.0)


def _start_from_sheath(
    protocol: InsertionProtocol,
    made: VirtualInsertion,
    camera: CalibratedCamera,
    state: SteeringState,
    command: SteeringCommand,
) -> tuple[SteeringState, SteeringCommand]:
    """Plan from the sheath's pose, if the protocol asks for it; stop in a sheath that is elsewhere."""
    if protocol.sheath.origin is None:
        return state, command
    pose = camera.see_sheath(made.world)
    origin = compare_with_command(pose, protocol.sheath, made.linear_mm, trial=0, frame=0)
    if not origin.accepted:
        return state, SteeringCommand(0.0, 0.0, 0.0, "sheath_astray", (origin.reason or "").rstrip("."))
    made.settings = with_start(made.settings, pose.tip_mm, pose.heading_rad)
    return start_steering(made.settings)


def _describe(made: _Made) -> TaskOutcome:
    """Return status, reason and values of an insertion."""
    end, insertion, bounds = made.end, made.insertion, made.end.bounds
    truth: Any = insertion.world.truth()
    off_mm = np.array((truth["tip_x_mm"], *truth["tip_mm"])) - truth["target_mm"]
    low_mm, high_mm = (None, None) if bounds is None else bounds.interval_mm
    x_mm, y_mm, z_mm = made.aim.target_mm
    reached = end.ending.reached
    values = {
        "true_target_error_mm": truth["true_target_error_mm"],
        "true_in_plane_error_mm": math.hypot(*off_mm[1:]),
        "true_out_of_plane_mm": abs(float(off_mm[0])),
        "true_min_clearance_mm": truth["true_min_clearance_mm"],
        "target_error_mm": None if bounds is None else bounds.in_plane_mm,
        "target_error_low_mm": low_mm,
        "target_error_high_mm": high_mm,
        "reached": reached,
        "replans": end.state.replans,
        "turns": len(insertion.bevel.turns),
        "length_mm": end.state.insertion_mm,
        "target_x_mm": x_mm,
        "target_y_mm": y_mm,
        "target_z_mm": z_mm,
    }
    if reached:
        return TaskOutcome("success", None, values)
    return TaskOutcome("failed", end.ending.reason, values)
