"""What a protocol is going to ask of the rig, known before anything moves."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

from labrig.devices import CheckStatus, RigDescription, check_axis_move, check_calibration, unknown_entries
from labrig.errors import LimitError, Problem
from labrig.experiments.design import design_problems
from labrig.protocol import AnyProtocol, CameraCalibrationProtocol, DesignProtocol, SteerabilityProtocol

PICTURES_A_TRIAL_BESIDE_ADVANCE = 3
"""The hole before the sheath goes in, the sheath before the needle goes in, and the final shape."""


@dataclass(frozen=True)
class PlannedMove:
    """One move of one axis: where from, where to [mm or rad], how fast [per s]."""

    where: str
    axis: str
    start: float
    position: float
    speed: float

    @property
    def duration_s(self) -> float:
        """Time at the set speed [s]; the ramps are short beside it."""
        return abs(self.position - self.start) / self.speed


@dataclass(frozen=True)
class Estimate:
    """What a run will take: rig time without the operator's, pictures, bytes on disk, and what the operator does."""

    duration_s: float
    pictures: int
    disk_bytes: int
    operator_steps: int

    @property
    def work(self) -> float:
        """What progress counts up to: rig time [s], or pictures where nothing moves."""
        return self.duration_s or float(self.pictures)


def trials_planned(protocol: AnyProtocol) -> int:
    """Return the number of trials of a run: insertions of a sweep, none of any other."""
    if isinstance(protocol, SteerabilityProtocol):
        return len(protocol.specimens) * protocol.insertions_per_specimen
    return 0


def planned_moves(protocol: SteerabilityProtocol) -> Iterator[PlannedMove]:
    """Yield the moves of one insertion, in order; every insertion of a sweep makes the same ones."""
    insertion, sheath = protocol.insertion, protocol.sheath
    yield PlannedMove("sheath.depth_mm", "linear", 0.0, sheath.depth_mm, sheath.speed_mm_s)
    yield PlannedMove("insertion.length_mm", "insertion", 0.0, insertion.length_mm, insertion.speed_mm_s)
    yield PlannedMove(
        "insertion.withdraw_speed_mm_s", "insertion", insertion.length_mm, 0.0, insertion.withdraw_speed_mm_s
    )
    yield PlannedMove("sheath.speed_mm_s", "linear", sheath.depth_mm, 0.0, sheath.speed_mm_s)


def find_problems(protocol: AnyProtocol, rig: RigDescription | None) -> tuple[Problem, ...]:
    """Return what this rig cannot do of this protocol: moves beyond a limit, and pictures that cannot be measured.

    A protocol that needs no rig (None) asks nothing of one; of a design, what no hinge can be is returned.
    """
    if isinstance(protocol, DesignProtocol):
        return design_problems(protocol)
    if rig is None:
        return ()
    problems = [
        Problem(f"rig {key}", "unknown", f"enter it: {where}") for key, where in unknown_entries(rig).items()
    ]
    if not isinstance(protocol, SteerabilityProtocol):
        return tuple(problems)
    turn = PlannedMove(
        "insertion.bevel_roll_rad",
        "rotation",
        0.0,
        protocol.insertion.bevel_roll_rad,
        rig.axes.rotation.max_speed / 2,
    )
    for move in (turn, *planned_moves(protocol)):
        try:
            check_axis_move(rig, move.axis, move.position, move.speed)
        except LimitError as error:
            problems.append(Problem(move.where, error.message, error.hint))
    problems += [
        Problem(result.check, result.value, result.solution)
        for result in check_calibration(rig)
        if result.status is CheckStatus.FAIL
    ]
    return tuple(problems)


def estimate(protocol: AnyProtocol, rig: RigDescription | None) -> Estimate:
    """Estimate rig time, pictures and disk of a run; a run without a rig (None) takes none of them.

    A PNG of a noisy camera takes about seven tenths of its raw bytes; a state line about 270 bytes.
    """
    if rig is None:
        return Estimate(0.0, 0, 0, 0)
    frame_bytes = int(
        (1.0 if rig.camera.store == "raw" else 0.7) * rig.camera.width_px * rig.camera.height_px
    )
    if isinstance(protocol, SteerabilityProtocol):
        trials = trials_planned(protocol)
        duration_s = trials * sum(move.duration_s for move in planned_moves(protocol))
        advance = math.ceil(protocol.insertion.length_mm / protocol.insertion.frame_every_mm) - 1
        pictures = trials * (advance + PICTURES_A_TRIAL_BESIDE_ADVANCE)
        steps = 1 + len(protocol.specimens) + trials
    elif isinstance(protocol, CameraCalibrationProtocol):
        duration_s, pictures, steps = 0.0, protocol.views + 1, protocol.views + 2
    else:
        duration_s, pictures, steps = 0.0, 0, 0
    states_bytes = int(duration_s * rig.recording.state_rate_hz * 270)
    return Estimate(duration_s, pictures, pictures * frame_bytes + states_bytes, steps)
