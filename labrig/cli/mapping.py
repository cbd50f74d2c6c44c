"""From pixels to mm as the commands are told it: calibration files, or the scale of rectified pictures."""

from pathlib import Path

from labrig.errors import InputError
from labrig.protocol import Direction
from labrig.vision import PlaneMap, load_intrinsics, load_plane


def plane_map(
    intrinsics: Path | None,
    plane: Path | None,
    px_per_mm: float | None,
    origin_px: tuple[float, float] | None,
    insertion: Direction,
) -> PlaneMap:
    """Return the plane map that the options describe.

    Raises
    ------
    InputError
        When the options describe none, or two at once.
    """
    if plane is not None and px_per_mm is None:
        return load_plane(plane, None if intrinsics is None else load_intrinsics(intrinsics))
    if plane is None and px_per_mm is not None:
        if origin_px is None:
            raise InputError(
                "--px-per-mm needs --origin-px U V", "name the pixel at which the needle enters the gel"
            )
        return PlaneMap.from_scale(px_per_mm, origin_px, insertion)
    raise InputError(
        "pixels cannot be turned into mm: give either --plane or --px-per-mm",
        "--intrinsics FILE --plane FILE for a calibrated camera; "
        "--px-per-mm S --origin-px U V --insertion DIR for rectified pictures",
    )
