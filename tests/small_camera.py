"""A small simulated camera, for tests that assert no accuracy: a picture takes a tenth of the time of 1280x720.

The calibration is that of the kept records, which were taken with the same camera.
"""

from pathlib import Path

_FOUND = Path(__file__).parent / "records" / "camera-calibration" / "analysis" / "001"

SMALL_WIDTH_PX, SMALL_HEIGHT_PX = 352, 224
_LENS = "fx_px: 493, fy_px: 494, cx_px: 178, cy_px: 110, distance_mm: 63, origin_px: [123, 112]"
SMALL_CAMERA = (
    f"camera.width_px={SMALL_WIDTH_PX}",
    f"camera.height_px={SMALL_HEIGHT_PX}",
    f"world.lens={{width_px: {SMALL_WIDTH_PX}, height_px: {SMALL_HEIGHT_PX}, {_LENS}}}",
)
"""Overrides of calibration/rig-simulated.yaml, as `load_rig` takes them."""

CALIBRATED_SMALL_CAMERA = (
    *SMALL_CAMERA,
    f"calibration.intrinsics={_FOUND / 'intrinsics.json'}",
    f"calibration.plane={_FOUND / 'plane.json'}",
)
"""The same, with lens and plane: a run that measures is accepted."""


def set_options(*overrides: str) -> tuple[str, ...]:
    """Return overrides of a rig file as options of `labrig run`."""
    return tuple(word for override in overrides for word in ("--set", f"rig.{override}"))
