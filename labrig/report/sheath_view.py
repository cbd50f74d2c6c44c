"""The sheath's end, cut out of its picture and enlarged: its pose as found and as commanded."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labrig.analysis.result import TrialOrigin
from labrig.errors import RecordError
from labrig.record.reader import Run
from labrig.report.pictures import Arrow, JpegSize, data_uri, jpeg, pixel
from labrig.vision.picture import size_of
from labrig.vision.plane import PlaneMap

# The range shown on each side of the tip, the lengths of the arrows, and the offset of their names from their ends.
_AROUND_MM, _FOUND_MM, _COMMANDED_MM, _ASIDE_MM = 6.0, 4.6, 3.6, 0.8
_CUT_OUT = JpegSize(1000, 88)


@dataclass(frozen=True)
class SheathView:
    """A cut-out of a picture with two arrows from the tip along the insertion, in pixels of the cut-out.

    `commanded` is None if the protocol has no expected pose.
    """

    origin: TrialOrigin
    href: str
    width: int
    height: int
    text_px: float
    found: Arrow
    commanded: Arrow | None


@dataclass(frozen=True)
class _Ray:
    """An arrow in the plane: start, heading, length, and the offset of its name from its end."""

    from_mm: tuple[float, float]
    heading_rad: float
    length_mm: float
    name_aside_mm: float


def draw_sheath_view(run: Run, origin: TrialOrigin, plane: PlaneMap) -> SheathView | None:
    """Return the sheath's end enlarged; None if it was not found or its picture cannot be read."""
    if origin.tip_mm is None or origin.tip_px is None or origin.heading_rad is None:
        return None
    try:
        image = run.read_frame(origin.frame)
    except RecordError:
        return None
    corner, size = _find_cut_out(origin.tip_px, size_of(image), plane)
    cut = image[corner[1] : corner[1] + size[1], corner[0] : corner[0] + size[0]]
    if not cut.size:
        return None
    aside_mm = _place_name(origin)
    found = _make_arrow("found", _Ray(origin.tip_mm, origin.heading_rad, _FOUND_MM, aside_mm), plane, corner)
    commanded = None
    if origin.expected_mm is not None:
        commanded = _make_arrow(
            "command", _Ray(origin.expected_mm, 0.0, _COMMANDED_MM, -aside_mm), plane, corner
        )
    return SheathView(
        origin=origin,
        href=data_uri(jpeg(cut, _CUT_OUT), "image/jpeg"),
        width=cut.shape[1],
        height=cut.shape[0],
        text_px=cut.shape[1] / 22,
        found=found,
        commanded=commanded,
    )


def _place_name(origin: TrialOrigin) -> float:
    """Return the offset of the name `found` [mm]: to the side of the other arrow on which its own ends."""
    if origin.tip_mm is None or origin.heading_rad is None or origin.expected_mm is None:
        return -_ASIDE_MM
    end_mm = origin.tip_mm[0] + _FOUND_MM * np.sin(origin.heading_rad)
    return _ASIDE_MM if end_mm > origin.expected_mm[0] else -_ASIDE_MM


def draw_sheath_views(
    run: Run, origins: Sequence[TrialOrigin], plane: PlaneMap, most: int
) -> list[SheathView]:
    """Draw up to `most` sheaths, refused ones first, then the largest deviations; return them in their order."""
    found = [origin for origin in origins if origin.tip_mm is not None]
    ranked = sorted(found, key=lambda item: (item.accepted, -(item.disagreement_mm or 0.0), item.trial))[
        :most
    ]
    views = (draw_sheath_view(run, origin, plane) for origin in sorted(ranked, key=lambda item: item.trial))
    return [view for view in views if view is not None]


def _find_cut_out(
    tip_px: tuple[float, float], size: tuple[int, int], plane: PlaneMap
) -> tuple[tuple[int, int], tuple[int, int]]:
    """Return the corner (u, v) and the size of the cut-out about the tip, clipped to the picture."""
    half = _AROUND_MM / plane.mm_per_px
    low = [max(0, round(middle - half)) for middle in tip_px]
    high = [min(most, round(middle + half)) for middle, most in zip(tip_px, size, strict=True)]
    return (low[0], low[1]), (max(0, high[0] - low[0]), max(0, high[1] - low[1]))


def _make_arrow(name: str, ray: _Ray, plane: PlaneMap, corner: tuple[int, int]) -> Arrow:
    """Return an arrow along a heading, with its name beside its end."""
    along = np.array([np.sin(ray.heading_rad), np.cos(ray.heading_rad)])
    aside = np.array([np.cos(ray.heading_rad), -np.sin(ray.heading_rad)])
    start = np.asarray(ray.from_mm)
    end = start + ray.length_mm * along
    px: NDArray[np.float64] = plane.to_px(np.array([start, end, end + ray.name_aside_mm * aside])) - corner
    return Arrow(name, *(pixel(point) for point in px))
