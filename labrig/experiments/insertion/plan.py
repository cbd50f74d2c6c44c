"""The plan of an insertion, and whether a path leads to its target, before anything moves."""

import math
from collections.abc import Iterator

from labrig.devices.needle_state import NeedleState
from labrig.devices.rig_file import RigDescription
from labrig.errors import LabrigError, Problem
from labrig.experiments.insertion.aim import find_aim_problems, find_pixel_problems, make_aim
from labrig.experiments.insertion.protocol import InsertionProtocol
from labrig.experiments.insertion.settings import make_insertion_settings
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
from labrig.steering.step import start_steering


def plan(protocol: InsertionProtocol, rig: RigDescription) -> RunPlan:
    """Return the plan of a run on a rig."""
    insertion, trials, steps = protocol.insertion, protocol.repetitions, protocol.roll_zero
    first = None if steps is None else make_roll_zero_order(protocol, steps)
    moves = plan_insertion_moves(
        "insertion.max_length_mm", insertion.max_length_mm, insertion, protocol.sheath
    )
    turn = plan_roll_move(rig, "roll_zero.rolls", 2 * math.pi)
    problems = (*find_rig_problems(protocol, rig, (turn, *moves)), *_find_roll_zero_problems(protocol, rig))
    problems = problems or tuple(_find_aim_problems(protocol, rig))
    looks = math.ceil(insertion.max_length_mm / insertion.frame_every_mm)
    pictures, operator_steps = count_sentinel_work(protocol.sentinel)
    return RunPlan(
        trials=trials,
        duration_s=estimate_roll_zero_s(protocol) + trials * total_duration_s(moves),
        pictures=trials * (looks + PICTURES_A_TRIAL_BESIDE_ADVANCE)
        + (0 if first is None else first.pictures)
        + pictures,
        operator_steps=2 * trials + (0 if first is None else 3 + first.steps.rolls) + operator_steps,
        problems=problems,
        refusal=None if problems else _foresee_refusal(protocol, rig),
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


def _find_aim_problems(protocol: InsertionProtocol, rig: RigDescription) -> Iterator[Problem]:
    """Yield places that are out of the camera's view or cannot be aimed at."""
    try:
        plane = load_tip_view(rig).plane
    except LabrigError as error:
        yield Problem("calibration.template", error.message, error.hint)
        return
    astray = tuple(find_pixel_problems(protocol, plane))
    yield from astray
    if not (astray or protocol.target.ask):
        yield from find_aim_problems(protocol, make_aim(protocol, plane), plane)


def _foresee_refusal(protocol: InsertionProtocol, rig: RigDescription) -> Problem | None:
    """Return the reason why no path leads to the target; None if there is a path, or the target is not known yet."""
    if protocol.target.ask:
        return None
    aim = make_aim(protocol, load_plane_map(rig))
    _, command = start_steering(make_insertion_settings(protocol, aim.target_mm, aim.obstacles))
    if command.stop is None:
        return None
    return Problem("target", f"there is no path: {command.detail}", "move target or obstacles")
