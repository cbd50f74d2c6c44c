"""The moves, pictures and disk space of a run, checked and estimated before anything moves."""

from collections.abc import Iterator
from dataclasses import replace

from labrig.devices.camera import require_calibrated_camera
from labrig.devices.check import check_calibration
from labrig.devices.check_result import CheckStatus
from labrig.devices.rig import Rig
from labrig.devices.rig_file import RigDescription, find_problems
from labrig.errors import Problem
from labrig.protocol.sections import ExperimentProtocol
from labrig.runner.experiment import RunPlan

_BYTES_A_STATE = 350
_PNG_SHARE = 0.7
"""Of its raw bytes a PNG of a noisy camera takes about so much."""


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
    for name, asked_ma in protocol.current_limits_ma.items():
        limit_ma = rig.axes.named(name).max_current_ma
        if limit_ma is not None and asked_ma > limit_ma:
            yield Problem(
                f"max_current_ma.{name}",
                f"{asked_ma} mA is above the limit of the rig file, {limit_ma} mA",
                f"ask for {limit_ma} mA or less, or raise axes.{name}.max_current_ma where the instrument bears it",
            )


def find_rig_problems(protocol: ExperimentProtocol, rig: RigDescription) -> Iterator[Problem]:
    """Yield what is wrong with a rig file, whatever the procedure does."""
    yield from (replace(problem, where=f"rig {problem.where}") for problem in find_problems(rig))
    yield from _find_picture_problems(protocol, rig)
    yield from _find_current_problems(protocol, rig)


def find_calibration_problems(rig: RigDescription) -> tuple[Problem, ...]:
    """Return what is wrong with the calibration of a rig."""
    return tuple(
        Problem(result.check, result.value, result.solution)
        for result in check_calibration(rig)
        if result.status is CheckStatus.FAIL
    )


def require_valid_calibration(plan: RunPlan, rig: Rig) -> None:
    """Refuse an opened rig whose camera reports another focus than the calibration that the run measures by.

    Raises
    ------
    InputError
        As `require_calibrated_camera`; what the rig file sets is a problem of the plan already.
    """
    if plan.uses_calibration:
        for path in rig.description.calibration_paths().values():
            require_calibrated_camera(rig.description.camera, path, rig.camera.settings)


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
    return plan.pictures * frame_bytes + int(plan.duration_s * rig.recording.state_rate_hz * _BYTES_A_STATE)
