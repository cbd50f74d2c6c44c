"""Pictures of a needle for a page, with the measurement drawn over them."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labrig.analysis.result import CentreLines
from labrig.errors import RecordError
from labrig.experiments.shared.curvature_result import PictureResult
from labrig.record.reader import Run
from labrig.report.pictures import (
    THUMBNAIL,
    VIEW,
    Arrow,
    JpegSize,
    Pixel,
    circle,
    data_uri,
    jpeg,
    pixel,
    polyline,
    scale_bar,
)
from labrig.vision.curvature import CentreLine
from labrig.vision.picture import size_of
from labrig.vision.plane import PlaneMap

FloatArray = NDArray[np.float64]
# A polyline of this many points looks like a curve at any size that a page has.
_LINE_POINTS = 60
_CIRCLE_POINTS = 180
_NO_LINE = CentreLine(np.empty((0, 2)), np.empty((0, 2)), (0, 0))
# Long enough to make a degree visible.
_DIRECTION_MM = 30.0


@dataclass(frozen=True)
class DrawnPicture:
    """A picture with overlaid lines.

    `width` and `height` are those of the recorded picture; every line is the `points` of an SVG polyline in
    its pixels, whatever size the JPEG has.
    """

    href: str
    width: int
    height: int
    shaft: str = ""
    window: str = ""
    circle: tuple[str, ...] = ()
    tip: Pixel | None = None
    found: tuple[Pixel, Pixel] | None = None


@dataclass(frozen=True)
class CameraView:
    """Figure 7c: one picture with the axes of the steering plane, a scale bar and a label on the sheath."""

    picture: DrawnPicture
    axes: tuple[Arrow, ...]
    scale_mm: float
    scale: tuple[Pixel, Pixel]
    sheath: Pixel
    text_px: float


def draw_thumbnail(
    run: Run, result: PictureResult, lines: CentreLines, plane: PlaneMap
) -> DrawnPicture | None:
    """Return a small picture with shaft and circle; None if the picture cannot be read."""
    return _draw(run, result, lines, plane, THUMBNAIL)


def draw_camera_view(
    run: Run,
    result: PictureResult,
    lines: CentreLines,
    plane: PlaneMap,
    commanded_mm: tuple[float, float] | None = None,
) -> CameraView | None:
    """Return the camera's view with axes at the sheath; None if the picture cannot be read.

    The axes start at the commanded position of the sheath's tip or, if that is not known, at its tip.
    """
    picture = _draw(run, result, lines, plane, VIEW)
    if picture is None or result.sheath_tip_mm is None:
        return None
    origin = np.asarray(result.sheath_tip_mm if commanded_mm is None else commanded_mm)
    length_mm, bar = scale_bar((picture.width, picture.height), plane)
    text_px = picture.width / 48
    u, v = pixel(plane.to_px([np.asarray(result.sheath_tip_mm) - (0.0, 0.6 * length_mm)])[0])
    return CameraView(
        picture=picture,
        axes=tuple(
            _make_arrow(name, origin, np.asarray(direction) * length_mm, plane)
            for name, direction in (("z", (0.0, 1.0)), ("y", (1.0, 0.0)))
        ),
        scale_mm=length_mm,
        scale=bar,
        sheath=(min(max(u, 2.5 * text_px), picture.width - 2.5 * text_px), v),
        text_px=text_px,
    )


def _draw(
    run: Run, result: PictureResult, lines: CentreLines, plane: PlaneMap, size: JpegSize
) -> DrawnPicture | None:
    try:
        image = run.read_frame(result.frame)
    except RecordError:
        return None
    width, height = size_of(image)
    line = lines.get(result.frame, _NO_LINE)
    return DrawnPicture(
        href=data_uri(jpeg(image, size), "image/jpeg"),
        width=width,
        height=height,
        shaft=polyline(_thin(line.px)),
        window=polyline(_thin(line.px[slice(*line.window)])),
        circle=_draw_circle(result, plane, (width, height)),
        tip=result.tip_px,
        found=_locate_origin(result, plane),
    )


def _locate_origin(result: PictureResult, plane: PlaneMap) -> tuple[Pixel, Pixel] | None:
    """Return the line that shows the trial's origin and direction; None if they are not known."""
    if result.origin_mm is None or result.origin_heading_rad is None:
        return None
    along = np.array([np.sin(result.origin_heading_rad), np.cos(result.origin_heading_rad)])
    start, end = plane.to_px(np.asarray(result.origin_mm) + np.outer([0.0, _DIRECTION_MM], along))
    return pixel(start), pixel(end)


def _draw_circle(result: PictureResult, plane: PlaneMap, size: tuple[int, int]) -> tuple[str, ...]:
    """Return the polylines of the fitted circle that lie in the picture."""
    if not result.accepted or result.centre_mm is None or result.radius_mm is None:
        return ()
    px = circle(result.centre_mm, result.radius_mm, plane, _CIRCLE_POINTS)
    inside = np.all((px > -20.0) & (px < np.asarray(size) + 20.0), axis=1)
    edges = np.flatnonzero(np.diff(np.concatenate(([False], inside, [False])).astype(np.int8)))
    runs = (px[first:last] for first, last in zip(edges[::2], edges[1::2], strict=True))
    return tuple(polyline(run) for run in runs if len(run) > 1)


def _thin(points: FloatArray) -> FloatArray:
    """Return at most `_LINE_POINTS` of the points, with both ends."""
    if len(points) <= _LINE_POINTS:
        return points
    kept = np.linspace(0, len(points) - 1, _LINE_POINTS).round().astype(np.intp)
    return np.asarray(points[kept])


def _make_arrow(name: str, origin_mm: FloatArray, vector_mm: FloatArray, plane: PlaneMap) -> Arrow:
    start, end, label = plane.to_px([origin_mm, origin_mm + vector_mm, origin_mm + 1.18 * vector_mm])
    return Arrow(name, pixel(start), pixel(end), pixel(label))
