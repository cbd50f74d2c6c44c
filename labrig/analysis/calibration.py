"""Load the calibration of a run: the map from pixels to mm, and the mask of pixels that are not the needle."""

from collections.abc import Iterable, Mapping

from labrig.errors import InputError
from labrig.protocol.sections import Scale
from labrig.protocol.yaml_file import validate_values
from labrig.record.reader import Run
from labrig.vision.calibration_file import load_intrinsics, load_plane
from labrig.vision.error_budget import ErrorBudget
from labrig.vision.intrinsics import Intrinsics
from labrig.vision.picture import Mask, load_mask
from labrig.vision.plane import PlaneMap

INTRINSICS_FILE = "intrinsics.json"
PLANE_FILE = "plane.json"
MASK_FILE = "mask"


def load_plane_map(run: Run) -> PlaneMap:
    """Return the plane map of a run: from its calibration files, or from the scale stated at import.

    Raises
    ------
    InputError
        When the run has neither, or its plane map was made with another lens.
    FileFormatError
        When a calibration file is malformed.
    RecordError
        When a calibration file was changed since the run began.
    """
    if PLANE_FILE in run.calibration_files:
        return load_plane(run.calibration_path(PLANE_FILE), load_lens(run))
    stated = run.protocol.get("scale")
    if not isinstance(stated, Mapping):
        raise InputError(
            f"{run.path} has no calibration/{PLANE_FILE}, so its pictures have no scale",
            "record it with a calibrated rig, or import the pictures again with --px-per-mm or --plane",
        )
    scale = validate_values(stated, f"scale of {run.path}", Scale)
    return PlaneMap.from_scale(scale.px_per_mm, scale.origin_px, scale.insertion)


def list_not_in_interval(plane: PlaneMap, budgets: Iterable[ErrorBudget | None]) -> tuple[str, ...]:
    """Return what error bars with these budgets leave out; nothing without an error bar."""
    known = [budget for budget in budgets if budget is not None]
    return plane.not_in_interval(source for budget in known for source in budget.missing) if known else ()


def load_lens(run: Run) -> Intrinsics | None:
    """Return the camera's intrinsics; None for a run without them, whose pictures are rectified."""
    if INTRINSICS_FILE not in run.calibration_files:
        return None
    return load_intrinsics(run.calibration_path(INTRINSICS_FILE))


def load_mask_of_run(run: Run) -> Mask | None:
    """Return the mask that a run began with; None without one.

    Raises
    ------
    RecordError
        When it was changed since the run began.
    InputError
        When the file is no mask.
    """
    kept = [name for name in run.calibration_files if name.startswith(f"{MASK_FILE}.")]
    return load_mask(run.calibration_path(kept[0])) if kept else None
