"""The last plane map of a camera, with which the commands of `labrig calibrate` compare the scale of a new one."""

from pathlib import Path

from labrig.cli.options import find_named_rig_file
from labrig.devices.rig_file import load_rig
from labrig.errors import CalibrationRefusedError
from labrig.vision.calibration_file import compare_with_last
from labrig.vision.picture import Picture, require_size
from labrig.vision.plane import PlaneMap
from labrig.vision.scale_check import ScaleComparison

CONFIRMATION = "give --camera-moved"


def require_picture_of_rig(picture: Picture, rig: Path | None) -> None:
    """Refuse a picture of another size than the camera of the rig takes.

    Raises
    ------
    PictureError
        With both sizes.
    """
    if rig is not None:
        description = load_rig(rig)
        camera = description.camera
        require_size(
            picture, (camera.width_px, camera.height_px), f"the camera of the rig {description.name}"
        )


def explain_no_comparison(rig: Path | None, *, camera_moved: bool) -> str:
    """Return why there is no last plane map, and that a confirmation confirmed nothing then."""
    why = (
        "; --rig FILE compares it with that of the rig"
        if find_named_rig_file(rig) is None
        else ": the rig has none yet"
    )
    moved = "; --camera-moved had no effect" if camera_moved else ""
    return f"The scale was compared with no earlier plane map{why}{moved}."


def find_last_plane(rig: Path | None, out: Path | None) -> Path | None:
    """Return the plane map that a new one is compared with: that of the rig, else the file that is replaced."""
    named = find_named_rig_file(rig)
    candidates = [out] if named is None else [load_rig(named).calibration_paths().get("plane.json"), out]
    return next((path for path in candidates if path is not None and path.is_file()), None)


def compare_with_file(found: PlaneMap, last: Path | None, *, camera_moved: bool) -> ScaleComparison | None:
    """Compare the scale of a plane map with that of the last one; None if there is no such file."""
    if last is None or not last.is_file():
        return None
    return compare_with_last(found, last, camera_moved=camera_moved)


def require_confirmed(run: str, comparison: ScaleComparison | None) -> None:
    """Refuse to adopt a run's plane map whose scale needs a person's confirmation.

    Raises
    ------
    CalibrationRefusedError
        With both scales, and how to confirm.
    """
    if comparison is not None and comparison.needs_confirmation:
        raise CalibrationRefusedError(
            f"{run} is not adopted: t{comparison.sentence[1:].rstrip('.')}",
            "measure the width of the picture with a ruler; if the camera, its lens or the height of the paper was "
            f"changed, {CONFIRMATION}",
        )
