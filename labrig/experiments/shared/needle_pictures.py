"""Pictures of a needle for a page, with the measurement drawn over them."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from labrig.analysis.result import CentreLines
from labrig.experiments.shared.curvature_result import PictureResult
from labrig.record.reader import Run
from labrig.report.pictures import THUMBNAIL, Plate, circle, photograph, pixel, polyline, scale_bar
from labrig.vision.plane import PlaneMap

FloatArray = NDArray[np.float64]
# A polyline of this many points looks like a curve at any size that a page has.
_LINE_POINTS = 60
_CIRCLE_POINTS = 180
# Long enough to make a degree visible.
_DIRECTION_MM = 30.0
# An arrow of length 1 along the second axis, with its head.
_ARROW = np.array([(0.0, 0.0), (0.0, 1.0), (0.08, 0.85), (0.0, 1.0), (-0.08, 0.85)])


def draw_picture(run: Run, result: PictureResult, lines: CentreLines, plane: PlaneMap) -> Plate | None:
    """Return a picture with shaft, circle, tip, origin, the plane's axes and a scale; None if it cannot be read."""
    plate = photograph(run, result.frame, THUMBNAIL)
    if plate is None:
        return None
    bar, start_mm = scale_bar((plate.width, plate.height), plane), result.origin_mm or result.sheath_tip_mm
    arrows = {} if start_mm is None else {"z": bar[0] * _ARROW, "y": bar[0] * _ARROW[:, ::-1]}
    axes_px = {name: plane.to_px(np.asarray(start_mm) + arrow_mm) for name, arrow_mm in arrows.items()}
    drawn = [*(("axis", px) for px in axes_px.values()), *_list_lines(result, lines, plane, plate)]
    return replace(
        plate,
        lines=tuple((name, polyline(px)) for name, px in drawn),
        words=tuple((name, pixel(px[0] + 1.25 * (px[1] - px[0]))) for name, px in axes_px.items()),
        bar=bar,
    )


def _list_lines(
    result: PictureResult, lines: CentreLines, plane: PlaneMap, plate: Plate
) -> Iterator[tuple[str, FloatArray]]:
    """Yield each line over a picture: its name and its pixels (N, 2)."""
    for arc in _list_arcs(result, plane, (plate.width, plate.height)):
        yield "circle", arc
    if line := lines.get(result.frame):
        yield "shaft", _thin(line.px)
        yield "window", _thin(line.px[slice(*line.window)])
    if result.origin_mm is not None and result.origin_heading_rad is not None:
        along = np.array([np.sin(result.origin_heading_rad), np.cos(result.origin_heading_rad)])
        yield "found", plane.to_px(np.asarray(result.origin_mm) + np.outer([0.0, _DIRECTION_MM], along))
    if result.tip_px is not None:
        angle = np.linspace(0.0, 2.0 * np.pi, _LINE_POINTS)
        ring = np.column_stack((np.cos(angle), np.sin(angle)))
        yield "tip", np.asarray(result.tip_px) + plate.width / 75 * ring


def _list_arcs(result: PictureResult, plane: PlaneMap, size: tuple[int, int]) -> Iterator[FloatArray]:
    """Yield the parts of the fitted circle that lie in the picture."""
    if result.centre_mm is None or result.radius_mm is None:
        return
    px = circle(result.centre_mm, result.radius_mm, plane, _CIRCLE_POINTS)
    inside = np.all((px > -20.0) & (px < np.asarray(size) + 20.0), axis=1)
    for part in np.split(px, np.flatnonzero(np.diff(inside)) + 1)[0 if inside[0] else 1 :: 2]:
        if len(part) > 1:
            yield part


def _thin(points: FloatArray) -> FloatArray:
    """Return at most `_LINE_POINTS` of the points, with both ends."""
    kept = np.linspace(0, len(points) - 1, min(len(points), _LINE_POINTS)).round().astype(np.intp)
    return np.asarray(points[kept])
