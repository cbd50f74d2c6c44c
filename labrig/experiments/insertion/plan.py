"""The plan of an insertion before anything moves: whether a path leads to its target, and how sure its end can be."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from labrig.devices.can_description import ONLY_SIMULATED
from labrig.devices.needle_state import NeedleState, RollZero
from labrig.devices.rig_file import RigDescription
from labrig.errors import LabrigError, Problem
from labrig.experiments.insertion.aim import find_aim_problems, find_pixel_problems, make_aim
from labrig.experiments.insertion.ending import EstimatedEnd, SeenEnd, bound_error
from labrig.experiments.insertion.marker_view import find_marker_problems, find_target_sd_mm
from labrig.experiments.insertion.protocol import InsertionProtocol
from labrig.experiments.insertion.settings import make_insertion_settings, make_out_of_plane
from labrig.experiments.shared.holes import find_near_holes
from labrig.experiments.shared.rig_view import load_plane_map, load_tip_view
from labrig.experiments.shared.roll_zero_search import RollZeroOrder
from labrig.protocol.sections import RollZeroSteps
from labrig.runner.experiment import RunPlan, total_duration_s
from labrig.runner.plan import (
    PICTURES_A_TRIAL_BESIDE_ADVANCE,
    count_sentinel_work,
    find_rig_problems,
    plan_insertion_moves,
    plan_roll_move,
)
from labrig.steering.out_of_plane import RolledStretch, budget_out_of_plane
from labrig.steering.parameters import Turning
from labrig.steering.planner import Plan
from labrig.steering.step import start_steering
from labrig.steering.torsion import BaseLimits, TurnAhead, plan_turn
from labrig.vision.shaft_tip import READ_PX


def plan(protocol: InsertionProtocol, rig: RigDescription) -> RunPlan:
    """Return the plan of a run on a rig."""
    insertion, trials, steps = protocol.insertion, protocol.repetitions, protocol.roll_zero
    specimen = protocol.specimen
    first = None if steps is None else make_roll_zero_order(protocol, steps)
    moves = plan_insertion_moves(
        "insertion.max_length_mm", insertion.max_length_mm, insertion, protocol.sheath
    )
    turn = plan_roll_move(rig, "roll_zero.rolls", 2 * math.pi)
    searched = () if first is None else first.plan_torsion_moves(rig)
    problems = (
        *find_rig_problems(protocol, rig, (turn, *moves, *searched)),
        *_find_roll_zero_problems(protocol, rig),
        *_find_unmeasured(protocol, rig),
        *find_near_holes(
            "specimen", specimen, [specimen.first_hole_mm], protocol.sheath.diameter_mm, specimen.width_mm
        ),
    )
    problems = problems or tuple(_find_aim_problems(protocol, rig))
    foreseen = _Foreseen() if problems else _foresee(protocol, rig)
    looks = math.ceil(insertion.max_length_mm / insertion.frame_every_mm)
    pictures, operator_steps = count_sentinel_work(protocol.sentinel)
    return RunPlan(
        trials=trials,
        duration_s=estimate_roll_zero_s(protocol) + trials * total_duration_s(moves),
        pictures=trials * (looks + PICTURES_A_TRIAL_BESIDE_ADVANCE + (protocol.markers is not None))
        + (0 if first is None else first.pictures)
        + pictures,
        operator_steps=(2 + protocol.asked_places) * trials
        + (0 if first is None else 3 + first.holes)
        + operator_steps,
        moves=moves,
        problems=problems,
        refusal=foreseen.refusal,
        warnings=(*foreseen.warnings, *_warn_of_torsion(protocol, rig), *_warn_of_marker_depth(protocol)),
        uses_calibration=True,
    )


def make_roll_zero_order(protocol: InsertionProtocol, steps: RollZeroSteps) -> RollZeroOrder:
    """Return the order for finding the roll zero of the needle."""
    return RollZeroOrder(
        protocol.needle, protocol.sheath, protocol.insertion, steps, protocol.planner.radius_mm
    )


def estimate_roll_zero_s(protocol: InsertionProtocol) -> float:
    """Return the rig time [s] of finding the roll zero; 0 if the protocol has no section for it."""
    return (
        0.0 if protocol.roll_zero is None else make_roll_zero_order(protocol, protocol.roll_zero).duration_s
    )


def _find_roll_zero_problems(protocol: InsertionProtocol, rig: RigDescription) -> Iterator[Problem]:
    """Yield a missing roll zero: none is certified in the rig's state, and the protocol does not find it first."""
    certified = NeedleState(rig.state_path).state.roll_zero
    needle_id = protocol.needle.needle_id
    if protocol.roll_zero is None and (certified is None or certified.needle_id != needle_id):
        other = "" if certified is None else f" (its roll zero is of needle {certified.needle_id})"
        yield Problem(
            "roll_zero",
            f"rig {rig.name} has no certified roll zero of needle {needle_id}{other}, and the protocol does not say "
            "how to find it",
            "say how under roll_zero:, or first labrig run protocols/roll-zero.yaml on this rig"
            if rig.state_path is not None
            else "say how under roll_zero:; a simulated rig without state_file is new in every run",
        )


def _find_unmeasured(protocol: InsertionProtocol, rig: RigDescription) -> Iterator[Problem]:
    """Yield what is stated to be exactly 0 and was not measured; in the simulated world alone that may be so.

    A success would rest on it.
    """
    unseen = protocol.out_of_plane
    if unseen is None or rig.kind == ONLY_SIMULATED:
        return
    if unseen.heading_sd_deg_per_root_mm == 0.0:
        yield Problem(
            "out_of_plane.heading_sd_deg_per_root_mm",
            f"0 says that needles on rig {rig.name} never wander out of the plane; only a simulated one does not",
            "state what you measured, or null: as much as in the plane",
        )
    if unseen.lag_sd_deg == 0.0 and not _knows_torsion(protocol, rig):
        yield Problem(
            "out_of_plane.lag_sd_deg",
            f"0 says that the bevel of needle {protocol.needle.needle_id} never lags behind the rotation axis, and its "
            f"torsion was not measured on rig {rig.name}",
            "measure it: torsion: {} under roll_zero:, or labrig run protocols/roll-zero.yaml; or state how far it may "
            "lag (5 to 45 degrees were seen in needles 100 mm deep)",
        )


def _knows_torsion(protocol: InsertionProtocol, rig: RigDescription) -> bool:
    """Return whether the lag of the bevel is measured before the insertion, and compensated."""
    if protocol.policy.turning != "compensated":
        return False
    certified, steps = (
        NeedleState(rig.state_path).recall_roll_zero(protocol.needle.needle_id),
        protocol.roll_zero,
    )
    if certified is not None:
        return certified.torsion is not None
    return steps is not None and steps.torsion is not None


def _warn_of_torsion(protocol: InsertionProtocol, rig: RigDescription) -> Iterator[Problem]:
    """Yield a measured torsion of another needle, which says nothing of this one."""
    certified = NeedleState(rig.state_path).state.roll_zero
    needle_id, steps = protocol.needle.needle_id, protocol.roll_zero
    if certified is None or certified.torsion is None or steps is None:
        return
    if certified.needle_id != needle_id and steps.torsion is None:
        yield Problem(
            "roll_zero.torsion",
            f"the torsion that rig {rig.name} knows is of needle {certified.needle_id}; that of {needle_id} is not "
            "compensated",
            "measure it: torsion: {} under roll_zero:, or labrig run protocols/roll-zero.yaml",
        )


def _warn_of_marker_depth(protocol: InsertionProtocol) -> Iterator[Problem]:
    """Yield markers beside the steering plane."""
    markers = protocol.markers
    if markers is not None and markers.x_mm != 0.0:
        yield Problem(
            "markers.x_mm",
            f"the markers lie {abs(markers.x_mm):g} mm {'behind' if markers.x_mm > 0 else 'before'} the calibrated "
            f"plane: what they move looks {'smaller' if markers.x_mm > 0 else 'larger'} there, and is scaled back by "
            "this number alone",
            "put them into the plane, or measure how far from it they are",
        )


def _find_aim_problems(protocol: InsertionProtocol, rig: RigDescription) -> Iterator[Problem]:
    """Yield places that are out of the camera's view or cannot be aimed at."""
    try:
        plane = load_tip_view(rig).plane
    except LabrigError as error:
        yield Problem("calibration.template", error.message, error.hint)
        return
    astray = tuple(find_pixel_problems(protocol, plane))
    yield from astray
    yield from find_marker_problems(protocol, plane)
    if not (astray or protocol.asked_places):
        yield from find_aim_problems(protocol, make_aim(protocol, plane), plane)


@dataclass(frozen=True)
class _Foreseen:
    """What the first plan says: why there is no path, or why its end may not be certified."""

    refusal: Problem | None = None
    warnings: tuple[Problem, ...] = ()


def _foresee(protocol: InsertionProtocol, rig: RigDescription) -> _Foreseen:
    """Plan the path, unless a place is not known yet, and bound the error at its end."""
    if protocol.asked_places:
        return _Foreseen()
    plane = load_plane_map(rig)
    aim = make_aim(protocol, plane)
    settings = make_insertion_settings(protocol, aim.target_mm, aim.obstacles)
    state, command = start_steering(settings)
    if command.stop is not None:
        message = f"there is no path: {command.detail}"
        return _Foreseen(refusal=Problem("target", message, "move target or obstacles"))
    roll_zero, radius_mm = _expect_roll_zero(protocol, rig), settings.problem.radius_mm
    unseen = make_out_of_plane(protocol, roll_zero.sd_rad, roll_zero.torsion)
    if unseen is None:
        return _Foreseen()
    rolled = _list_stretches(state.plan, roll_zero, rig, protocol.policy.turning, radius_mm)
    budget = budget_out_of_plane(rolled, radius_mm, unseen)
    end = EstimatedEnd(np.array(aim.target_mm[1:]), READ_PX * plane.mm_per_px)
    seen = SeenEnd.of_estimate(end, plane)
    bounds = bound_error(seen, budget, aim.target_mm, find_target_sd_mm(protocol, None))
    warning = bounds.warn(settings.problem.tolerance_mm)
    return _Foreseen(warnings=() if warning is None else (warning,))


def _expect_roll_zero(protocol: InsertionProtocol, rig: RigDescription) -> RollZero:
    """Return the certified roll zero, or one that is only just certified."""
    needle_id = protocol.needle.needle_id
    certified = NeedleState(rig.state_path).recall_roll_zero(needle_id)
    if certified is not None or protocol.roll_zero is None:
        return certified or RollZero(needle_id, 0.0, 0.0, "")
    return RollZero(needle_id, 0.0, math.radians(protocol.roll_zero.max_sd_deg), "")


def _list_stretches(
    path: Plan, roll_zero: RollZero, rig: RigDescription, turning: Turning, radius_mm: float
) -> list[RolledStretch]:
    """Return the arcs of a path with the directions in which the bevel will be turned before them."""
    limits = BaseLimits.of_axis(rig.axes.rotation.limits, roll_zero.zero_rad)
    ahead = [TurnAhead(arc.roll_rad, arc.length_mm) for arc in path.arcs]
    base_rad, turned, rolled = 0.0, 0, list[RolledStretch]()
    for number, arc in enumerate(path.arcs):
        if arc.roll_rad != 0.0:
            turn = plan_turn(
                rolled,
                base_rad,
                ahead[number:],
                roll_zero.lag,
                limits,
                turning=turning,
                radius_mm=radius_mm,
            )
            base_rad, turned = turn.to_rad, turn.direction
        rolled.append(RolledStretch(arc.length_mm, base_rad, turned))
    return rolled
