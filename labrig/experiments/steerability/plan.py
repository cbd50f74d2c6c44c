"""What a sweep asks of a rig, known before anything moves."""

import math

from labrig.devices.rig_file import RigDescription
from labrig.experiments.steerability.protocol import SteerabilityProtocol
from labrig.runner.experiment import PlannedMove, RunPlan, total_duration_s
from labrig.runner.plan import (
    PICTURES_A_TRIAL_BESIDE_ADVANCE,
    find_rig_problems,
    insertion_moves,
    roll_move,
    sentinel_work,
)


def trial_moves(protocol: SteerabilityProtocol) -> tuple[PlannedMove, ...]:
    """Return the moves of one insertion, in order; every insertion of a sweep makes the same ones."""
    insertion = protocol.insertion
    return insertion_moves("insertion.length_mm", insertion.length_mm, insertion, protocol.sheath)


def plan(protocol: SteerabilityProtocol, rig: RigDescription) -> RunPlan:
    """Return what the protocol is going to ask of a rig."""
    insertion, moves = protocol.insertion, trial_moves(protocol)
    trials = len(protocol.specimens) * protocol.insertions_per_specimen
    advance = math.ceil(insertion.length_mm / insertion.frame_every_mm) - 1
    pictures, operator_steps = sentinel_work(protocol.sentinel)
    turn = roll_move(rig, "insertion.bevel_roll_rad", insertion.bevel_roll_rad)
    return RunPlan(
        trials=trials,
        duration_s=trials * total_duration_s(moves),
        pictures=trials * (advance + PICTURES_A_TRIAL_BESIDE_ADVANCE) + pictures,
        operator_steps=1 + len(protocol.specimens) + trials + operator_steps,
        problems=find_rig_problems(protocol, rig, (turn, *moves)),
    )
