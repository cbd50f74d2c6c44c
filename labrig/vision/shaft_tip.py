"""Tip and heading of a needle from its shaft alone, without a template."""

from dataclasses import dataclass, replace

import numpy as np

from labrig.errors import MeasurementRefusedError
from labrig.vision.error_budget import ErrorBudget, PlaceErrors, budget_place
from labrig.vision.out_of_plane import BendingPlane
from labrig.vision.picture import Mask, Picture, require_size
from labrig.vision.plane import PlaneMap
from labrig.vision.shaft import FloatArray, Shaft, locate_shaft

# Longest and shortest stretch of the centre line whose parabola is extrapolated to the tip: the bevel does not have two
# edges with a centre line between them.
_OVER_MM, _LEAST_MM = 5.0, 1.5
# The last rows, over this many needle widths, lean towards the longer side of the bevel.
_BEVEL_ONSET = 0.3
# Standard deviation of a shaft's end in the picture: in pixels, and as a share of the length over which its darkness
# fades. A bevel has no edge square to the shaft: where it is seen to end depends on its shape, on the gel and on the
# focus. In drawn pictures it fades over 1 to 2 px and the end is found 1.2 px short; in photographs of a real needle it
# fades over 2 to 11 px, and the end is 2.3 px off its mark (rms). Within 1.96 of these deviations lay 95 % of the tips
# in 300 drawn pictures, and 91 % of those in 85 photographs.
_LEAST_READ_PX, _READ_SHARE = 0.3, 0.53
# That of a sharp tip, for what is said before there is a picture: the darkness fades over 1.8 px.
READ_PX = 1.0


@dataclass(frozen=True, eq=False)
class ShaftTip:
    """The end of a needle's centre line.

    Attributes
    ----------
    tip_px, tip_mm : (float, float)
        (u, v) and (y, z), level with the foremost point of the bevel.
    heading_rad : float
        Heading at the tip.
    length_mm : float
        Arc length from the entry to the tip.
    width_px : float
        Width of the needle.
    centre_line_mm : ndarray (N, 2)
    arc_mm, widths_mm : ndarray (N,)
        Arc length from the entry, and width, at each point of the centre line.
    errors : PlaceErrors
        Of the end.
    """

    tip_px: tuple[float, float]
    tip_mm: tuple[float, float]
    heading_rad: float
    length_mm: float
    width_px: float
    centre_line_mm: FloatArray
    arc_mm: FloatArray
    widths_mm: FloatArray
    errors: PlaceErrors


def measure_shaft_tip(
    image: Picture,
    plane: PlaneMap,
    diameter_mm: float,
    sheath_diameter_mm: float | None,
    *,
    mask: Mask | None = None,
) -> ShaftTip:
    """Measure where the needle in a picture ends.

    Parameters
    ----------
    image : ndarray of uint8, (H, W) or (H, W, 3)
    plane : PlaneMap
    diameter_mm : float
        Of the needle, within a factor of about 1.5.
    sheath_diameter_mm : float or None
        None if the picture shows no sheath.
    mask : ndarray of bool (H, W), optional
        Pixels that are not the needle.

    Raises
    ------
    MeasurementRefusedError
        If the picture does not show exactly one shaft with its tip, or too little of it for a heading.
    PictureError
        If the picture has another size than the plane was calibrated for.
    """
    require_size(image, plane.image_size, "the plane map")
    shaft = locate_shaft(image, plane, diameter_mm, sheath_diameter_mm, mask=mask)
    end_mm = shaft.arc_mm[-1] - _BEVEL_ONSET * shaft.width_mm
    last = (shaft.arc_mm >= end_mm - _OVER_MM) & (shaft.arc_mm <= end_mm)
    arc_mm = shaft.arc_mm[last] - shaft.length_mm
    seen_mm = float(arc_mm[-1] - arc_mm[0]) if len(arc_mm) else 0.0
    if seen_mm < _LEAST_MM:
        raise MeasurementRefusedError(
            f"{seen_mm:.1f} mm of the needle are seen, and {_LEAST_MM:g} mm are the least for a heading"
        )
    (y, z), (slope_y, slope_z) = np.polynomial.polynomial.polyfit(arc_mm, shaft.centre_mm[last], 2)[:2]
    tip_px = plane.to_px(np.array([[y, z]]))[0]
    return ShaftTip(
        tip_px=(float(tip_px[0]), float(tip_px[1])),
        tip_mm=(float(y), float(z)),
        heading_rad=float(np.arctan2(slope_y, slope_z)),
        length_mm=shaft.length_mm,
        width_px=shaft.width_mm / plane.mm_per_px,
        centre_line_mm=shaft.centre_mm,
        arc_mm=shaft.arc_mm,
        widths_mm=shaft.widths_mm,
        errors=_find_errors(shaft, plane),
    )


def budget_tip(shaft: Shaft, plane: PlaneMap, roll_sd_rad: float | None) -> ErrorBudget:
    """Return the error budget of the tip of a located shaft.

    A needle that bends out of the plane stands before or behind it, which only the camera's place tells.
    """
    errors = _find_errors(shaft, plane)
    if roll_sd_rad is not None and plane.intrinsics is not None:
        tip_mm = plane.to_mm(shaft.tip_px[None])
        bending = BendingPlane.of(shaft.entry_px, shaft.arc_mm, shaft.centre_mm, plane)
        errors = replace(errors, roll_shift_mm=(bending.project(tip_mm, roll_sd_rad) - tip_mm)[0])
    return budget_place(plane, shaft.tip_px, errors)


def _find_errors(shaft: Shaft, plane: PlaneMap) -> PlaceErrors:
    """Return the errors of a shaft's end that are neither of the map nor of the roll."""
    read_px = float(np.hypot(_LEAST_READ_PX, _READ_SHARE * shaft.tip_fade_px))
    return PlaceErrors(light_shift_mm=shaft.light_shift_mm[-1], fit_mm=read_px * plane.mm_per_px)
