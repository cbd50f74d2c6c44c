"""The moves, pictures and disk space of a run, checked and estimated before anything moves."""

from collections.abc import Iterable, Iterator
from typing import Protocol

from labrig.devices.camera import require_calibrated_camera
from labrig.devices.check import check_calibration
from labrig.devices.check_result import CheckStatus
from labrig.devices.rig import Rig
from labrig.devices.rig_file import RigDescription, check_axis_move, section_problems, unknown_entries
from labrig.errors import LimitError, Problem
from labrig.protocol.sections import ExperimentProtocol, GridSentinel, Sheath
from labrig.runner.experiment import PlannedMove, RunPlan

PICTURES_A_TRIAL_BESIDE_ADVANCE = 3
"""The hole before the sheath goes in, the sheath before the needle goes in, and the final shape."""

_GRID_PICTURES = 2
"""Before the run and after it; for each the paper is laid, and taken away again."""

_BYTES_A_STATE = 350
_PNG_SHARE = 0.7
"""Of its raw bytes a PNG of a noisy camera takes about so much."""


class Speeds(Protocol):
    """The speeds of insertion and withdrawal in a protocol [mm/s]."""

    @property
    def speed_mm_s(self) -> float:
        """Insertion speed [mm/s]."""
        ...

    @property
    def withdraw_speed_mm_s(self) -> float:
        """Withdrawal speed [mm/s]."""
        ...


def plan_insertion_moves(
    key: str, length_mm: float, speeds: Speeds, sheath: Sheath
) -> tuple[PlannedMove, ...]:
    """Return the moves of one insertion, in order: sheath in, needle in, needle out, sheath out.

    Parameters
    ----------
    key : str
        The protocol's key of the inserted length.
    length_mm : float
        That length.
    speeds, sheath
        The protocol's sections.
    """
    return (
        PlannedMove("sheath.depth_mm", "linear", 0.0, sheath.depth_mm, sheath.speed_mm_s),
        PlannedMove(key, "insertion", 0.0, length_mm, speeds.speed_mm_s),
        PlannedMove("insertion.withdraw_speed_mm_s", "insertion", length_mm, 0.0, speeds.withdraw_speed_mm_s),
        PlannedMove("sheath.speed_mm_s", "linear", sheath.depth_mm, 0.0, sheath.speed_mm_s),
    )


def plan_roll_move(rig: RigDescription, key: str, farthest_rad: float) -> PlannedMove:
    """Return the largest turn of the bevel from its first position, at half the axis' speed."""
    return PlannedMove(key, "rotation", 0.0, farthest_rad, rig.axes.rotation.max_speed / 2)


def count_sentinel_work(sentinel: GridSentinel | None) -> tuple[int, int]:
    """Return the numbers of pictures and operator steps for the graph paper before and after a run."""
    return (0, 0) if sentinel is None else (_GRID_PICTURES, 2 * _GRID_PICTURES)


def find_rig_file_problems(rig: RigDescription) -> Iterator[Problem]:
    """Yield the empty entries of a rig file, and the problems of the files that it names."""
    for key, where in unknown_entries(rig).items():
        yield Problem(f"rig {key}", "unknown", f"enter it: {where}")
    for key, problem in section_problems(rig):
        yield Problem(f"rig {key}", problem.message, problem.hint)


def _find_picture_problems(protocol: ExperimentProtocol, rig: RigDescription) -> Iterator[Problem]:
    """Yield a camera with recorded pictures if pictures decide how real drives move."""
    if protocol.pictures_decide_motion and rig.camera.recorded and rig.kind == "bench":
        yield Problem(
            "rig camera.driver",
            f"{protocol.experiment} moves real drives by what its pictures show, and camera.driver "
            f"{rig.camera.driver} gives recorded pictures",
            "use a camera that shows the needle as it is now, or a rig of kind simulated",
        )


def _find_current_problems(protocol: ExperimentProtocol, rig: RigDescription) -> Iterator[Problem]:
    """Yield a current limit of the protocol above that of the rig file."""
    axes = dict(rig.axes.items())
    for name, asked_ma in protocol.current_limits_ma.items():
        limit_ma = axes[name].max_current_ma
        if limit_ma is not None and asked_ma > limit_ma:
            yield Problem(
                f"max_current_ma.{name}",
                f"{asked_ma} mA is above the limit of the rig file, {limit_ma} mA",
                f"ask for {limit_ma} mA or less, or raise axes.{name}.max_current_ma where the instrument bears it",
            )


def find_rig_problems(
    protocol: ExperimentProtocol, rig: RigDescription, moves: Iterable[PlannedMove]
) -> tuple[Problem, ...]:
    """Return the problems of an experiment that moves and measures: moves beyond a limit, no calibration."""
    uncalibrated = (
        Problem(result.check, result.value, result.solution)
        for result in check_calibration(rig)
        if result.status is CheckStatus.FAIL
    )
    return (*find_move_problems(protocol, rig, moves), *uncalibrated)


def find_move_problems(
    protocol: ExperimentProtocol, rig: RigDescription, moves: Iterable[PlannedMove]
) -> tuple[Problem, ...]:
    """Return the problems of an experiment that moves; it may measure in pixels, without a calibration."""
    problems = [
        *find_rig_file_problems(rig),
        *_find_picture_problems(protocol, rig),
        *_find_current_problems(protocol, rig),
    ]
    for move in moves:
        try:
            check_axis_move(rig, move.axis, move.position, move.speed)
        except LimitError as error:
            problems.append(Problem(move.where, error.message, error.hint))
    return tuple(problems)


def require_valid_calibration(plan: RunPlan, rig: Rig) -> None:
    """Refuse an opened rig whose camera reports another focus than the calibration that the run measures by.

    Raises
    ------
    InputError
        As `require_calibrated_camera`; what the rig file sets is a problem of the plan already.
    """
    if plan.uses_calibration:
        for path in rig.description.calibration_paths().values():
            require_calibrated_camera(rig.description.camera, path, rig.camera.settings.reported)


def count_needed_bytes(plan: RunPlan, rig: RigDescription | None, share: float = 1.0) -> int:
    """Return the free disk space that a share of a run asks for, with what the rig file wants to stay free."""
    least_free_mb = 0.0 if rig is None else rig.recording.least_free_mb
    return int(share * estimate_disk_bytes(plan, rig) + 1e6 * least_free_mb)


def estimate_disk_bytes(plan: RunPlan, rig: RigDescription | None) -> int:
    """Return the disk space that a run will take [bytes]; 0 without a rig (None)."""
    if rig is None:
        return 0
    share = 1.0 if rig.camera.store == "pgm" else _PNG_SHARE
    frame_bytes = int(share * rig.camera.width_px * rig.camera.height_px)
    states_bytes = int(plan.duration_s * rig.recording.state_rate_hz * _BYTES_A_STATE)
    return plan.pictures * frame_bytes + states_bytes
