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
    if plane is not None and (px_per_mm, origin_px, insertion) != (None, None, None):
        raise InputError(
            "--plane turns pixels into mm, and so do --px-per-mm, --origin-px and --insertion",
            "give the one or the others",
        )
    if plane is None:
        if px_per_mm is None or origin_px is None or insertion is None:
            raise InputError(
                "pixels cannot be turned into mm: neither --plane is given, nor all of --px-per-mm, --origin-px and "
                "--insertion",
                "--intrinsics FILE --plane FILE for a calibrated camera; --px-per-mm S --origin-px U V --insertion DIR "
                "for rectified pictures: U V is where the needle enters the gel",
            )
        return PlaneMap.from_scale(px_per_mm, origin_px, insertion)
    lens = None if intrinsics is None else load_intrinsics(intrinsics)
    found = load_plane(plane, lens)
    for path, calibration in ((intrinsics, lens), (plane, found)):
        if calibration is not None and not calibration.accepted:
            reasons = "; ".join(calibration.reasons)
            raise InputError(
                f"{path} was refused when it was made: {reasons}", "calibrate again as this says"
            )
    return found
