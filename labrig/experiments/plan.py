"""What a protocol is going to ask of the rig, known before anything moves."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

from labrig.analysis.insertion_settings import insertion_settings
from labrig.devices.check import check_calibration
from labrig.devices.check_result import CheckStatus
from labrig.devices.needle_state import rig_state
from labrig.devices.rig_file import RigDescription, check_axis_move, unknown_entries
from labrig.errors import LabrigError, LimitError, Problem
from labrig.experiments.aim import aim_of, aim_problems, pixel_problems
from labrig.experiments.design import design_problems
from labrig.experiments.insertion import roll_zero_s
from labrig.experiments.roll_zero import order_of
from labrig.experiments.sight import load_eye, load_plane_map
from labrig.protocol.insertion import InsertionProtocol, RollZeroProtocol, RollZeroSteps
from labrig.protocol.load import AnyProtocol
from labrig.protocol.protocols import CameraCalibrationProtocol, DesignProtocol, Sheath, SteerabilityProtocol
from labrig.steering.step import start_steering

MovingProtocol = SteerabilityProtocol | InsertionProtocol | RollZeroProtocol

PICTURES_A_TRIAL_BESIDE_ADVANCE = 3
"""The hole before the sheath goes in, the sheath before the needle goes in, and the final shape."""


_GRID_PICTURES = 2
"""Before the run and after it; for each the paper is laid, and taken away again."""


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
    return protocol.repetitions if isinstance(protocol, InsertionProtocol) else 0


def planned_moves(protocol: MovingProtocol) -> Iterator[PlannedMove]:
    """Yield the moves of one insertion, in order; every insertion of a run makes the same ones at most."""
    insertion, sheath = protocol.insertion, protocol.sheath
    key, length_mm = _length(protocol)
    yield PlannedMove("sheath.depth_mm", "linear", 0.0, sheath.depth_mm, sheath.speed_mm_s)
    yield PlannedMove(key, "insertion", 0.0, length_mm, insertion.speed_mm_s)
    yield PlannedMove(
        "insertion.withdraw_speed_mm_s", "insertion", length_mm, 0.0, insertion.withdraw_speed_mm_s
    )
    yield PlannedMove("sheath.speed_mm_s", "linear", sheath.depth_mm, 0.0, sheath.speed_mm_s)


def _length(protocol: MovingProtocol) -> tuple[str, float]:
    """Return the key that says how far the needle goes, and how far."""
    match protocol:
        case SteerabilityProtocol():
            return "insertion.length_mm", protocol.insertion.length_mm
        case InsertionProtocol():
            return "insertion.max_length_mm", protocol.insertion.max_length_mm
        case RollZeroProtocol():
            return "roll_zero.length_mm", protocol.roll_zero.length_mm


def _farthest_roll(protocol: MovingProtocol) -> tuple[str, float]:
    """Return the key that says how far the bevel is turned, and how far from where it stands at first."""
    match protocol:
        case SteerabilityProtocol():
            return "insertion.bevel_roll_rad", protocol.insertion.bevel_roll_rad
        case RollZeroProtocol():
            return "roll_zero.rolls", _last_roll_rad(protocol.roll_zero)
        case InsertionProtocol():
            sought = protocol.roll_zero
            return "roll_zero.rolls", 2 * math.pi if sought is None else max(
                _last_roll_rad(sought), 2 * math.pi
            )


def _last_roll_rad(steps: RollZeroSteps) -> float:
    return 2 * math.pi * (steps.rolls - 1) / steps.rolls


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
    problems += _picture_problems(protocol, rig)
    if not isinstance(protocol, MovingProtocol):
        return tuple(problems)
    key, farthest_rad = _farthest_roll(protocol)
    turn = PlannedMove(key, "rotation", 0.0, farthest_rad, rig.axes.rotation.max_speed / 2)
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
    if isinstance(protocol, InsertionProtocol):
        problems += _roll_zero_problems(protocol, rig)
        problems += _sight_problems(protocol, rig) if not problems else ()
    return tuple(problems)


def _picture_problems(protocol: AnyProtocol, rig: RigDescription) -> Iterator[Problem]:
    """Yield recorded pictures where pictures decide how real drives move."""
    if protocol.pictures_decide_motion and rig.camera.recorded and rig.kind == "bench":
        yield Problem(
            "rig camera.driver",
            f"{protocol.experiment} moves real drives by what its pictures show, and camera.driver "
            f"{rig.camera.driver} gives recorded pictures",
            "use a camera that shows the needle as it is now, or a rig of kind simulated",
        )


def _roll_zero_problems(protocol: InsertionProtocol, rig: RigDescription) -> Iterator[Problem]:
    """Yield a roll zero that is neither certified, as the rig remembers, nor to be found first."""
    certified = rig_state(rig.state_path).roll_zero
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


def foreseen_refusal(protocol: AnyProtocol, rig: RigDescription | None) -> Problem | None:
    """Return why no path leads to an insertion's target, as the run would end; None where one does, or nobody knows."""
    if not isinstance(protocol, InsertionProtocol) or rig is None or protocol.target.ask:
        return None
    aim = aim_of(protocol, load_plane_map(rig))
    _, command = start_steering(insertion_settings(protocol, aim.target_mm, aim.obstacles))
    if command.stop is None:
        return None
    return Problem("target", f"there is no path: {command.detail}", "move target or obstacles")


def _sight_problems(protocol: InsertionProtocol, rig: RigDescription) -> Iterator[Problem]:
    """Yield what the camera cannot see of an insertion, and what cannot be aimed at."""
    try:
        eye = load_eye(rig)
    except LabrigError as error:
        yield Problem("calibration.template", error.message, error.hint)
        return
    astray = tuple(pixel_problems(protocol, eye.plane))
    yield from astray
    if not (astray or protocol.target.ask):
        yield from aim_problems(protocol, aim_of(protocol, eye.plane), eye.plane)


def _roll_pictures(steps: RollZeroSteps, sheath: Sheath) -> int:
    """Return how many pictures finding the roll zero takes: of each insertion, and of the sheath before it."""
    return steps.rolls * (1 if sheath.origin is None else 2)


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
    elif isinstance(protocol, InsertionProtocol):
        trials, zero, found_first_s = protocol.repetitions, protocol.roll_zero, roll_zero_s(protocol)
        duration_s = found_first_s + trials * sum(move.duration_s for move in planned_moves(protocol))
        looks = math.ceil(protocol.insertion.max_length_mm / protocol.insertion.frame_every_mm)
        pictures = trials * (looks + PICTURES_A_TRIAL_BESIDE_ADVANCE) + (
            0 if zero is None else _roll_pictures(zero, protocol.sheath)
        )
        steps = 2 * trials + (0 if zero is None else 3 + zero.rolls)
    elif isinstance(protocol, RollZeroProtocol):
        pictures = _roll_pictures(protocol.roll_zero, protocol.sheath)
        duration_s = order_of(protocol).duration_s
        steps = 3 + protocol.roll_zero.rolls
    elif isinstance(protocol, CameraCalibrationProtocol):
        duration_s, pictures, steps = 0.0, protocol.views + 1, protocol.views + 2
    else:
        duration_s, pictures, steps = 0.0, 0, 0
    if isinstance(protocol, MovingProtocol) and protocol.sentinel is not None:
        pictures, steps = pictures + _GRID_PICTURES, steps + 2 * _GRID_PICTURES
    states_bytes = int(duration_s * rig.recording.state_rate_hz * 270)
    return Estimate(duration_s, pictures, pictures * frame_bytes + states_bytes, steps)
