"""What an insertion asks of a rig, and whether a path leads to its target, known before anything moves."""

import math
from collections.abc import Iterator

from labrig.devices.needle_state import NeedleState
from labrig.devices.rig_file import RigDescription
from labrig.errors import LabrigError, Problem
from labrig.experiments.insertion.aim import aim_of, aim_problems, pixel_problems
from labrig.experiments.insertion.protocol import InsertionProtocol
from labrig.experiments.insertion.settings import insertion_settings
from labrig.experiments.shared.rig_view import load_plane_map, load_tip_view
from labrig.experiments.shared.roll_zero_search import RollZeroOrder
from labrig.protocol.sections import RollZeroSteps
from labrig.runner.experiment import RunPlan, total_duration_s
from labrig.runner.plan import (
    PICTURES_A_TRIAL_BESIDE_ADVANCE,
    find_rig_problems,
    insertion_moves,
    roll_move,
    sentinel_work,
)
from labrig.steering.step import start_steering


def plan(protocol: InsertionProtocol, rig: RigDescription) -> RunPlan:
    """Return what the protocol is going to ask of a rig."""
    insertion, trials, steps = protocol.insertion, protocol.repetitions, protocol.roll_zero
    first = None if steps is None else roll_zero_order(protocol, steps)
    moves = insertion_moves("insertion.max_length_mm", insertion.max_length_mm, insertion, protocol.sheath)
    turn = roll_move(rig, "roll_zero.rolls", 2 * math.pi)
    problems = (*find_rig_problems(protocol, rig, (turn, *moves)), *_roll_zero_problems(protocol, rig))
    problems = problems or tuple(_sight_problems(protocol, rig))
    looks = math.ceil(insertion.max_length_mm / insertion.frame_every_mm)
    pictures, operator_steps = sentinel_work(protocol.sentinel)
    return RunPlan(
        trials=trials,
        duration_s=roll_zero_s(protocol) + trials * total_duration_s(moves),
        pictures=trials * (looks + PICTURES_A_TRIAL_BESIDE_ADVANCE)
        + (0 if first is None else first.pictures)
        + pictures,
        operator_steps=2 * trials + (0 if first is None else 3 + first.steps.rolls) + operator_steps,
        problems=problems,
        refusal=None if problems else _foreseen_refusal(protocol, rig),
    )


def roll_zero_order(protocol: InsertionProtocol, steps: RollZeroSteps) -> RollZeroOrder:
    """Return what finding the roll zero of an insertion's needle takes."""
    return RollZeroOrder(
        protocol.needle, protocol.sheath, protocol.insertion, steps, protocol.planner.radius_mm
    )


def roll_zero_s(protocol: InsertionProtocol) -> float:
    """Return the rig time [s] that finding the roll zero takes; none where the protocol does not say how."""
    return 0.0 if protocol.roll_zero is None else roll_zero_order(protocol, protocol.roll_zero).duration_s


def _roll_zero_problems(protocol: InsertionProtocol, rig: RigDescription) -> Iterator[Problem]:
    """Yield a roll zero that is neither certified, as the rig remembers, nor to be found first."""
    certified = NeedleState(rig.state_path).state.roll_zero
    needle_id = protocol.needle.needle_id
    if protocol.roll_zero is None and (certified is None or certified.needle_id != needle_id):
        yield Problem(
            "roll_zero",
            f"rig {rig.name} has no certified roll zero of needle {needle_id}, and the protocol does not say how to "
            "find it",
            "say how under roll_zero:, or first labrig run protocols/roll-zero.yaml on this rig"
            if rig.state_path is not None
            else "say how under roll_zero:; a simulated rig without state_file is new in every run",
        )


def _sight_problems(protocol: InsertionProtocol, rig: RigDescription) -> Iterator[Problem]:
    """Yield what the camera cannot see of an insertion, and what cannot be aimed at."""
    try:
        plane = load_tip_view(rig).plane
    except LabrigError as error:
        yield Problem("calibration.template", error.message, error.hint)
        return
    astray = tuple(pixel_problems(protocol, plane))
    yield from astray
    if not (astray or protocol.target.ask):
        yield from aim_problems(protocol, aim_of(protocol, plane), plane)


def _foreseen_refusal(protocol: InsertionProtocol, rig: RigDescription) -> Problem | None:
    """Return why no path leads to the target, as the run would end; None where one does, or nobody knows."""
    if protocol.target.ask:
        return None
    aim = aim_of(protocol, load_plane_map(rig))
    _, command = start_steering(insertion_settings(protocol, aim.target_mm, aim.obstacles))
    if command.stop is None:
        return None
    return Problem("target", f"there is no path: {command.detail}", "move target or obstacles")
