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
from numpy.typing import NDArray

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
_CONTRAST, _LEAST_STRIPES = 0.5, 7
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
    """The sheath's middle line: y = y_mm + slope z."""

    y_mm: float
    slope: float

    @property
    def heading_rad(self) -> float:
        return float(np.arctan(self.slope))

    def at(self, along_mm: FloatArray, aside_mm: FloatArray) -> FloatArray:
        """Return points (..., 2) as (y, z): `along_mm` from z = 0 along the axis, `aside_mm` towards +y."""
        sine, cosine = np.sin(self.heading_rad), np.cos(self.heading_rad)
        y = self.y_mm + along_mm * sine + aside_mm * cosine
        return np.stack((y, along_mm * cosine - aside_mm * sine), axis=-1)


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
    shaft = locate_shaft(image, plane, diameter_mm, None)
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
    return _Axis(y_mm, slope)


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
    stripes = _sample_strip(grey, plane, axis, along_mm, aside_mm)
    steel = np.median(stripes[along_mm <= along_mm[0] + _STEEL_MM], axis=0)
    beside_mm = 0.5 * width_mm + np.linspace(_GEL_FROM_MM, _GEL_TO_MM, 9)
    gel = float(
        np.median(_sample_strip(grey, plane, axis, along_mm, np.concatenate((-beside_mm, beside_mm))))
    )
    contrast = gel - steel
    usual = float(np.median(contrast[contrast > 0.0])) if (contrast > 0.0).any() else np.inf
    ends = [
        _find_stripe_end(stripes[:, column], 0.5 * (gel + steel[column]), along_mm)
        for column in np.flatnonzero(contrast >= _CONTRAST * usual)
    ]
    found = [end for end in ends if end is not None]
    if len(found) < _LEAST_STRIPES:
        raise MeasurementRefusedError(
            f"the sheath's end is seen in {len(found)} of {_STRIPES} stripes along it, {_LEAST_STRIPES} are the least"
        )
    early = float(np.quantile(found, _EARLY))
    return float(np.median([end for end in found if abs(end - early) <= _ALIKE_MM]))


def _sample_strip(
    grey: Picture, plane: PlaneMap, axis: _Axis, along_mm: FloatArray, aside_mm: FloatArray
) -> NDArray[np.float32]:
    """Return the grey values (along, aside) of a strip along the axis."""
    places = axis.at(along_mm[:, None], aside_mm[None, :])
    u, v = (plane.to_px(places.reshape(-1, 2)).T.reshape(2, *places.shape[:2])).astype(np.float32)
    read = cv2.remap(grey, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(read, dtype=np.float32)


def _find_stripe_end(stripe: NDArray[np.float32], level: float, along_mm: FloatArray) -> float | None:
    """Return where a smoothed stripe first rises through a level; None if it does not."""
    long = max(2, round(_ENDED_MM / float(along_mm[1] - along_mm[0])))
    smooth = np.convolve(stripe, np.full(long, 1.0 / long), mode="same")
    dark = smooth < level
    rises = np.flatnonzero(dark[:-1] & ~dark[1:])
    rises = rises[rises >= long]
    if not len(rises):
        return None
    first = int(rises[0])
    part = (level - smooth[first]) / (smooth[first + 1] - smooth[first])
    return float(along_mm[first] + part * (along_mm[first + 1] - along_mm[first]))
