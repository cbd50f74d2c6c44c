"""What a run keeps beside its pictures: the map from pixels to mm, and the mask of what is not the needle."""

from collections.abc import Mapping

from labrig.errors import InputError
from labrig.protocol.sections import Scale
from labrig.protocol.yaml_file import validate_values
from labrig.record.reader import Run
from labrig.vision.calibration_file import load_intrinsics, load_plane
from labrig.vision.intrinsics import Intrinsics
from labrig.vision.mask import Mask, load_mask
from labrig.vision.plane import PlaneMap

INTRINSICS_FILE = "intrinsics.json"
PLANE_FILE = "plane.json"
MASK_FILE = "mask"


def load_mapping(run: Run) -> PlaneMap:
    """Return the plane map of a run: its calibration files, or the scale that was stated at import.

    Raises
    ------
    InputError
        When the run has neither, or its plane map was made with another lens.
    FileFormatError
        When a calibration file is malformed.
    RecordError
        When a calibration file is not the one that the run began with.
    """
    plane_path = run.calibration_path(PLANE_FILE)
    if plane_path.is_file():
        return load_plane(plane_path, load_lens(run))
    stated = run.protocol.get("scale")
    if not isinstance(stated, Mapping):
        raise InputError(
            f"{run.path} has no calibration/{PLANE_FILE}, so its pictures have no scale",
            "record it with a calibrated rig, or import the pictures again with --px-per-mm or --plane",
        )
    scale = validate_values(stated, f"scale of {run.path}", Scale)
    return PlaneMap.from_scale(scale.px_per_mm, scale.origin_px, scale.insertion)


def load_lens(run: Run) -> Intrinsics | None:
    """Return the camera's intrinsics, or None for a run without them: its pictures are rectified already."""
    path = run.calibration_path(INTRINSICS_FILE)
    return load_intrinsics(path) if path.is_file() else None


def load_kept_mask(run: Run) -> Mask | None:
    """Return the mask that a run keeps since it began, None where it has none.

    Raises
    ------
    RecordError
        When it is not the one that the run began with.
    InputError
        When it is none.
    """
    kept = sorted(run.calibration_path(MASK_FILE).parent.glob(f"{MASK_FILE}.*"))
    return load_mask(run.calibration_path(kept[0].name)) if kept else None
