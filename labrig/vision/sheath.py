"""Tip and heading of the sheath in a picture taken before the needle leaves it.

The search for the shaft finds the tube, but its model of a needle's end (bevel, bend) does not fit a sheath. A sheath
is straight, so its heading is that of a straight line through the whole centre line. Its end is blunt, so each stripe
along it ends where the grey value is half way between steel and gel. The tip is the median of the stripes that end
early and close together. A bubble in front of some stripes then has no effect, although the darkness ends only behind
it.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from labrig.errors import MeasurementRefusedError
from labrig.vision.picture import Picture, as_grey, require_size
from labrig.vision.plane import PlaneMap
from labrig.vision.shaft import FloatArray, locate_shaft

# Shortest visible sheath for a heading.
_LEAST_MM = 3.0
# A point further from the line than this many standard deviations does not count; number of passes.
_OUTLIER, _PASSES = 3.0, 4
# Number of stripes, share of the sheath's width that they cover, and sampling step in pixels.
_STRIPES, _STRIPES_OVER, _STEP_PX = 21, 0.7, 0.25
# The end is searched for from this far behind the end of the darkness to this far beyond it. The steel's grey value is
# measured on the first stretch, which no bubble at the end reaches.
_BEHIND_MM, _BEYOND_MM, _STEEL_MM = 6.0, 2.0, 2.0
# The gel's grey value is measured beside the sheath, between these distances from its edges.
_GEL_FROM_MM, _GEL_TO_MM = 0.75, 2.0
# Least contrast of a stripe as a share of the median (a stripe in a glint has none), and fewest stripes.
_CONTRAST, _LEAST_STRIPES = 0.5, 5
# A bubble in front of the end can only lengthen a stripe. So those stripes count that end within this distance of an
# early quantile.
_EARLY, _ALIKE_MM = 0.25, 0.15
# A stripe ends if gel follows for this length; bright spots in the steel are shorter.
_ENDED_MM = 0.4


@dataclass(frozen=True)
class SheathPose:
    """The end of the sheath.

    Attributes
    ----------
    tip_px, tip_mm : (float, float)
        The middle of the end, (u, v) and (y, z).
    heading_rad : float
        Heading of the sheath.
    width_mm : float
    """

    tip_px: tuple[float, float]
    tip_mm: tuple[float, float]
    heading_rad: float
    width_mm: float


@dataclass(frozen=True)
class _Axis:
    """The sheath's middle line: where it is at z = 0, and its heading."""

    y_mm: float
    heading_rad: float

    def at(self, along_mm: FloatArray, aside_mm: FloatArray) -> FloatArray:
        """Return points (..., 2) as (y, z): `along_mm` from z = 0 along the axis, `aside_mm` towards +y."""
        places = (along_mm + 1j * aside_mm) * np.exp(1j * self.heading_rad)
        return np.stack((self.y_mm + places.imag, places.real), axis=-1)


def measure_sheath(image: Picture, plane: PlaneMap, diameter_mm: float) -> SheathPose:
    """Measure tip and heading of the sheath in a picture.

    Parameters
    ----------
    image : ndarray of uint8, (H, W) or (H, W, 3)
        The sheath alone, the needle inside it.
    plane : PlaneMap
    diameter_mm : float
        Of the sheath, within a factor of about 1.5.

    Raises
    ------
    MeasurementRefusedError
        If the picture does not show exactly one sheath with its end.
    PictureError
        If the picture has another size than the plane was calibrated for.
    """
    require_size(image, plane.image_size, "the plane map")
    shaft = locate_shaft(image, plane, diameter_mm, None, needle_inside=True)
    seen_mm = float(shaft.arc_mm[-1] - shaft.arc_mm[0])
    if seen_mm < _LEAST_MM:
        raise MeasurementRefusedError(
            f"{seen_mm:.1f} mm of the sheath are seen, and {_LEAST_MM:g} mm are the least for its heading"
        )
    axis = _fit_axis(shaft.centre_mm)
    dark_to_mm = float(plane.to_mm(shaft.tip_px[None])[0, 1]) / np.cos(axis.heading_rad)
    end_mm = _find_end_mm(as_grey(image), plane, axis, dark_to_mm, shaft.width_mm)
    tip = axis.at(np.array(end_mm), np.array(0.0))
    u, v = plane.to_px(tip[None])[0].tolist()
    return SheathPose((u, v), (float(tip[0]), float(tip[1])), axis.heading_rad, shaft.width_mm)


def measure_heading(centre_mm: FloatArray) -> float | None:
    """Return the heading [rad] of a sheath's centre line (N, 2), columns (y, z); None if it is too short."""
    if not len(centre_mm) or float(np.ptp(centre_mm[:, 1])) < _LEAST_MM:
        return None
    return _fit_axis(centre_mm).heading_rad


def _fit_axis(centre_mm: FloatArray) -> _Axis:
    """Fit a straight line to a centre line (N, 2) without outliers."""
    y, z = centre_mm.T
    kept = np.ones(len(y), dtype=bool)
    for _ in range(_PASSES):
        y_mm, slope = np.polynomial.polynomial.polyfit(z[kept], y[kept], 1).tolist()
        off = np.abs(y - y_mm - slope * z)
        kept = off <= max(_OUTLIER * 1.4826 * float(np.median(off)), 1e-6)
    return _Axis(y_mm, float(np.arctan(slope)))


def _find_end_mm(grey: Picture, plane: PlaneMap, axis: _Axis, dark_to_mm: float, width_mm: float) -> float:
    """Return how far along the axis the sheath ends, from its stripes.

    Raises
    ------
    MeasurementRefusedError
        If too few stripes show an end.
    """
    step_mm = _STEP_PX * plane.mm_per_px
    along_mm = np.arange(dark_to_mm - _BEHIND_MM, dark_to_mm + _BEYOND_MM, step_mm)
    aside_mm = np.linspace(-0.5, 0.5, _STRIPES) * _STRIPES_OVER * width_mm
    beside_mm = 0.5 * width_mm + np.linspace(_GEL_FROM_MM, _GEL_TO_MM, 9)
    places = axis.at(along_mm[:, None], np.concatenate((aside_mm, -beside_mm, beside_mm)))
    u, v = plane.to_px(places.reshape(-1, 2)).T.reshape(2, *places.shape[:2]).astype(np.float32)
    strip = cv2.remap(grey, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE).astype(np.float32)
    stripes, gel = strip[:, :_STRIPES], float(np.median(strip[:, _STRIPES:]))
    steel = np.median(stripes[along_mm <= along_mm[0] + _STEEL_MM], axis=0)
    contrast = gel - steel
    usual = float(np.median(contrast[contrast > 0.0])) if (contrast > 0.0).any() else np.inf
    # Where each stripe, smoothed, first rises half way from the steel to the gel.
    long = max(2, round(_ENDED_MM / step_mm))
    rise = cv2.blur(stripes, (1, long)) - 0.5 * (gel + steel)
    ends = (rise[:-1] < 0.0) & (rise[1:] >= 0.0)
    ends[:long] = False
    column = np.flatnonzero(ends.any(axis=0) & (contrast >= _CONTRAST * usual))
    row = ends.argmax(axis=0)[column]
    below, above = rise[row, column], rise[row + 1, column]
    found = along_mm[row] + below / (below - above) * step_mm
    alike = found[np.abs(found - np.quantile(found, _EARLY)) <= _ALIKE_MM] if len(found) else found
    if len(alike) < _LEAST_STRIPES:
        raise MeasurementRefusedError(
            f"the sheath's end is seen in {len(alike)} of {_STRIPES} stripes along it, {_LEAST_STRIPES} are the least"
        )
    return float(np.median(alike))
