"""Seeing the tip, where it is expected and where a picture shows it; the sheath; and which pictures show nothing."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labrig.analysis.origin import sheath_origin, unseen_origin
from labrig.analysis.result import TrialOrigin
from labrig.devices.rig_file import RigDescription
from labrig.errors import CameraError, InputError, MeasurementRefusedError
from labrig.protocol.sections import Sheath
from labrig.steering.tip import TipState
from labrig.vision.calibration_file import load_intrinsics, load_plane
from labrig.vision.mask import Mask, load_mask
from labrig.vision.picture import Picture
from labrig.vision.plane import PlaneMap
from labrig.vision.sheath import measure_sheath
from labrig.vision.template_file import load_template
from labrig.vision.tip import TipFix, locate_tip, next_region_px
from labrig.vision.tip_template import TipTemplate

_DARKEST_GREY = 12.0
_SIGMAS = 4.0
_LEAST_REACH_PX = 12.0
_MISSES_WITH_HEADING = 2
"""A cavity leads the heading astray by as much as a fix may turn; after so many misses every heading is tried."""

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Eye:
    """What turns a picture into a place: plane map, mask, and the template with its heading told from that plane."""

    plane: PlaneMap
    template: TipTemplate
    mask: Mask | None = None

    def pixel_of(self, place_mm: tuple[float, float, float]) -> tuple[float, float]:
        """Return the pixel (u, v) at which a point (x, y, z) of the steering plane is seen."""
        u, v = self.plane.to_px(np.array([place_mm[1:]]))[0].tolist()
        return u, v


@dataclass(frozen=True, eq=False)
class TipSeen:
    """Where the tip was looked for, and what was found; `position_mm` (3,) is None where it was not.

    region_px : side of the square around `near_px` that was searched.
    """

    fix: TipFix
    position_mm: FloatArray | None
    near_px: tuple[float, float]
    heading_rad: float
    region_px: float

    def to_json(self) -> dict[str, Any]:
        """Return what is recorded of it."""
        position = None if self.position_mm is None else self.position_mm.tolist()
        asked = {"near_px": list(self.near_px), "heading_rad": self.heading_rad, "region_px": self.region_px}
        found = self.fix.to_json()
        return {**found, "seen_heading_rad": found["heading_rad"], **asked, "tip_mm": position}


def load_eye(rig: RigDescription) -> Eye:
    """Return the eye of a rig from its calibration files.

    Raises
    ------
    InputError
        When one is missing; `find_problems` says so before a run.
    """
    plane = load_plane_map(rig)
    files = rig.template_paths()
    if not files:
        raise InputError(
            "the rig file names no template of the tip",
            "labrig calibrate template makes one; see calibration:",
        )
    template = load_template(files["template.png"]).relative_to(plane.insertion)
    masks = [load_mask(path) for path in rig.mask_paths().values()]
    return Eye(plane, template, masks[0] if masks else None)


def load_plane_map(rig: RigDescription) -> PlaneMap:
    """Return the plane map of a rig from its calibration files.

    Raises
    ------
    InputError
        When it has none, or one that cannot be read.
    """
    paths = rig.calibration_paths()
    if "plane.json" not in paths:
        raise InputError("the rig file names no plane", "labrig run protocols/calibration.yaml finds it")
    lens = paths.get("intrinsics.json")
    return load_plane(paths["plane.json"], None if lens is None else load_intrinsics(lens))


def look_for_tip(eye: Eye, image: Picture, expected: FloatArray, tip: TipState, roll_rad: float) -> TipSeen:
    """Look for the tip where it is expected; the more pictures have shown none, the wider, and then turned any way.

    Parameters
    ----------
    expected : (4, 4) array
        Predicted pose of the tip.
    tip : TipState
        The last estimate, whose uncertainty and misses set how far is searched.
    roll_rad : float
        Of the bevel.
    """
    u, v = eye.plane.to_px(expected[None, 1:3, 3])[0].tolist()
    heading_rad = math.atan2(expected[1, 2], expected[2, 2])
    reach_px = max(_LEAST_REACH_PX, _SIGMAS * tip.position_sd_mm / eye.plane.mm_per_px)
    region_px = next_region_px(max(eye.template.picture.shape) + 2 * reach_px, tip.misses)
    asked_rad = heading_rad if tip.misses < _MISSES_WITH_HEADING else None
    masked = None if eye.mask is None else eye.mask.masked("", image)
    fix = locate_tip(
        image,
        eye.template,
        near_px=(u, v),
        heading_rad=asked_rad,
        roll_rad=roll_rad,
        region_px=region_px,
        mask=masked,
    )
    position = None
    if fix.tip_px is not None:
        position = np.array((0.0, *eye.plane.to_mm(np.array([fix.tip_px]))[0]))
    return TipSeen(fix, position, (u, v), heading_rad, region_px)


def look_for_sheath(
    image: Picture, plane: PlaneMap, sheath: Sheath, linear_mm: float, *, trial: int, frame: int
) -> TrialOrigin:
    """Return where the sheath stands in a picture that shows it alone; refused where it is not seen.

    Parameters
    ----------
    linear_mm : float
        The linear encoder's reading at the exposure.

    Raises
    ------
    CameraError
        For a dark picture.
    """
    require_light(image)
    try:
        pose = measure_sheath(image, plane, sheath.diameter_mm)
    except MeasurementRefusedError as refusal:
        return unseen_origin(refusal.message, trial=trial, frame=frame)
    return sheath_origin(pose, sheath, linear_mm, trial=trial, frame=frame)


def require_light(image: Picture) -> None:
    """Refuse a picture in which nothing can be seen.

    Raises
    ------
    CameraError
        For a dark picture, with its mean and the limit.
    """
    mean = float(image.mean())
    if mean < _DARKEST_GREY:
        raise CameraError(
            f"the picture is dark: its mean is {mean:.1f} of 255, and {_DARKEST_GREY:g} is the least",
            "check the light and the lens cap; then take the needle out with labrig devices withdraw",
        )
