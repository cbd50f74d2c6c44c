"""The map from pixels to mm by the options: calibration files, or the scale of rectified pictures."""

from pathlib import Path

from labrig.errors import InputError
from labrig.protocol.model import Direction
from labrig.vision.calibration_file import load_intrinsics, load_plane
from labrig.vision.plane import PlaneMap


def load_plane_map(
    intrinsics: Path | None,
    plane: Path | None,
    px_per_mm: float | None,
    origin_px: tuple[float, float] | None,
    insertion: Direction | None,
) -> PlaneMap:
    """Return the plane map that the options describe.

    Raises
    ------
    InputError
        When the options describe no map, two maps, or a refused calibration.
    """
    if plane is not None and px_per_mm is not None:
        raise InputError("--plane and --px-per-mm both turn pixels into mm", "give one of them")
    if plane is not None and origin_px is not None:
        raise InputError("--origin-px belongs to --px-per-mm; a plane map has its origin", "leave it out")
    if plane is not None:
        return _load_calibrated(intrinsics, plane, insertion)
    if px_per_mm is None:
        raise InputError(
            "pixels cannot be turned into mm: neither --plane nor --px-per-mm is given",
            "--intrinsics FILE --plane FILE for a calibrated camera; "
            "--px-per-mm S --origin-px U V --insertion DIR for rectified pictures",
        )
    if origin_px is None:
        raise InputError(
            "--px-per-mm needs --origin-px U V", "name the pixel at which the needle enters the gel"
        )
    if insertion is None:
        raise InputError(
            "--px-per-mm needs --insertion", "say where the insertion points: right, left, up or down"
        )
    return PlaneMap.from_scale(px_per_mm, origin_px, insertion)


def _load_calibrated(intrinsics: Path | None, plane: Path, insertion: Direction | None) -> PlaneMap:
    lens = None if intrinsics is None else load_intrinsics(intrinsics)
    found = load_plane(plane, lens)
    for path, calibration in ((intrinsics, lens), (plane, found)):
        if calibration is not None and not calibration.accepted:
            reasons = "; ".join(calibration.reasons)
            raise InputError(
                f"{path} was refused when it was made: {reasons}", "calibrate again as this says"
            )
    if insertion is not None and insertion != found.insertion:
        raise InputError(
            f"--insertion is {insertion}, and {plane} was made for {found.insertion}",
            "leave --insertion out, or calibrate the plane for that direction",
        )
    return found
