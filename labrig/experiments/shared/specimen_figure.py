"""Figures of a specimen: its tracks, true to scale, and the curvature over age and over the number of the track."""

from collections.abc import Callable, Iterable, Sequence

import matplotlib as mpl
import numpy as np
import shapely
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from labrig.experiments.shared.hole_map import TrackShape
from labrig.experiments.shared.specimen_result import CurvatureTrend, SpecimenMap
from labrig.protocol.specimen_file import SpecimenTrack
from labrig.report.figures import SETTINGS, svg
from labrig.report.palette import mark

_EARLIER = "#9a9a9a"
_OWN, _NEXT = mark(0).colour, mark(2).colour
_DASHED = (0, (4, 2))
_MOST_NUMBERS = 40
"""More numbers than that run into each other."""
_PER_M = 1000.0


def draw_hole_map(specimen: SpecimenMap, next_shape: TrackShape | None, name: str) -> Markup:
    """Draw the tracks of a specimen from above: earlier ones grey, the run's own in colour, the next one dashed."""
    tracks = [TrackShape.of_track(track) for track in specimen.tracks]
    with mpl.rc_context(SETTINGS):
        figure = Figure(figsize=(9.6, _choose_height(tracks)), layout="constrained")
        axes = figure.subplots()
        for number, shape in enumerate(tracks):
            _fill(axes, shape, _EARLIER if number < specimen.earlier else _OWN)
            if len(tracks) <= _MOST_NUMBERS:
                _write_number(axes, shape, str(number + 1))
        if next_shape is not None:
            for line, _ in next_shape.parts:
                along, across = line.xy
                axes.plot(across, along, color=_NEXT, linewidth=1.4, linestyle=_DASHED)
            _write_number(axes, next_shape, "next")
        _explain(axes, specimen, is_next_drawn=next_shape is not None)
        axes.set_aspect("equal", adjustable="datalim")
        axes.set_xlabel("across, from the first entry point (mm)")
        axes.set_ylabel("along the insertion (mm)")
        axes.grid(visible=True)
        return svg(figure, name)


def _choose_height(tracks: Sequence[TrackShape]) -> float:
    """Return the height of a map that is as wide as the page, so that little of it is empty [inches]."""
    points = np.array([point for shape in tracks for point in shape.path_mm] or [(60.0, 0.0)])
    across_mm = max(float(np.ptp(points[:, 1])), 60.0) + 20.0
    return min(max(1.2 + 8.4 * (float(points[:, 0].max()) + 10.0) / across_mm, 2.6), 7.0)


def _fill(axes: Axes, shape: TrackShape, colour: str) -> None:
    """Draw a track as wide as its sheath and its needle."""
    sheath, needle = (
        line.buffer(diameter_mm / 2, cap_style="flat", quad_segs=4) for line, diameter_mm in shape.parts
    )
    outline = shapely.get_coordinates(shapely.get_exterior_ring(sheath.union(needle)))
    axes.fill(outline[:, 1], outline[:, 0], color=colour, alpha=0.7, linewidth=0)


def _write_number(axes: Axes, shape: TrackShape, text: str) -> None:
    place = (shape.hole_position_mm, 0.0)
    axes.annotate(text, place, xytext=(0, -2), textcoords="offset points", ha="center", va="top", fontsize=7)


def _explain(axes: Axes, specimen: SpecimenMap, *, is_next_drawn: bool) -> None:
    """Add a legend of the tracks that are in the figure."""
    if specimen.earlier:
        axes.plot([], [], color=_EARLIER, linewidth=4, alpha=0.7, label="earlier runs")
    if len(specimen.tracks) > specimen.earlier:
        axes.plot([], [], color=_OWN, linewidth=4, alpha=0.7, label="this run")
    if is_next_drawn:
        axes.plot([], [], color=_NEXT, linewidth=1.4, linestyle=_DASHED, label="next hole")
    axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=3)


def draw_curvatures(specimen: SpecimenMap, name: str) -> Markup | None:
    """Draw the curvature of each track over age and over its number, with the trends; None without a trend."""
    if not specimen.trends:
        return None
    quantities: Sequence[tuple[str, str, Callable[[int, SpecimenTrack], float]]] = (
        ("age_h", "age of the block (h)", lambda _, track: track.age_h),
        ("track", "number of the track", lambda number, _: float(number)),
    )
    with mpl.rc_context(SETTINGS):
        figure = Figure(figsize=(9.6, 3.2), layout="constrained")
        panels = figure.subplots(1, 2, sharey=True)
        for axes, (over, label, find_place) in zip(panels, quantities, strict=True):
            _draw_points(axes, specimen, find_place)
            for trend in specimen.trends:
                if trend.over == over:
                    _draw_trend(axes, trend, _list_places(specimen, find_place))
            axes.set_xlabel(label)
            axes.grid(visible=True)
        panels[0].set_ylabel("curvature (1/m)")
        panels[1].legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
        return svg(figure, name)


def _list_places(
    specimen: SpecimenMap, find_place: Callable[[int, SpecimenTrack], float]
) -> list[tuple[float, float]]:
    """Return place and curvature [1/m] of each track that the trends rest on."""
    return [
        (find_place(number, track), _PER_M / track.radius_mm)
        for number, track in enumerate(specimen.tracks, start=1)
        if track.radius_mm is not None and track.needle_id == specimen.needle_id
    ]


def _draw_points(
    axes: Axes, specimen: SpecimenMap, find_place: Callable[[int, SpecimenTrack], float]
) -> None:
    groups: dict[tuple[str, str, str], list[tuple[float, float]]] = {}
    for number, track in enumerate(specimen.tracks, start=1):
        if track.radius_mm is None:
            continue
        look = _choose_look(track, specimen, is_earlier=number <= specimen.earlier)
        groups.setdefault(look, []).append((find_place(number, track), _PER_M / track.radius_mm))
    for (colour, fill, label), points in groups.items():
        axes.plot(*_split(points), "o", color=colour, fillstyle=fill, markersize=4.5, label=label)


def _choose_look(track: SpecimenTrack, specimen: SpecimenMap, *, is_earlier: bool) -> tuple[str, str, str]:
    """Return colour, fill and label of a point."""
    if track.needle_id != specimen.needle_id:
        return _EARLIER, "none", "other needles"
    return (_EARLIER, "full", "earlier runs") if is_earlier else (_OWN, "full", "this run")


def _split(points: Iterable[tuple[float, float]]) -> tuple[list[float], list[float]]:
    held = list(points)
    return [point[0] for point in held], [point[1] for point in held]


def _draw_trend(axes: Axes, trend: CurvatureTrend, points: Sequence[tuple[float, float]]) -> None:
    """Draw the line through the mean of the points; dashed if it does not drift."""
    places = np.array([point[0] for point in points])
    ends = np.array([places.min(), places.max()])
    values = _PER_M * (trend.mean_curvature_per_mm + trend.slope * (ends - places.mean()))
    style = "-" if trend.drifts else _DASHED
    axes.plot(ends, values, color="#333333", linewidth=1.2, linestyle=style, label="line fitted")
