"""The curvature in a specimen over its age and over the number of the track."""

from collections.abc import Callable, Iterable, Sequence

import matplotlib as mpl
import numpy as np
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from labrig.experiments.shared.specimen_result import CurvatureTrend, SpecimenMap
from labrig.protocol.specimen_file import SpecimenTrack
from labrig.report.figures import SETTINGS, svg
from labrig.report.palette import mark

_EARLIER = "#9a9a9a"
_OWN = mark(0).colour
_DASHED = (0, (4, 2))
_PER_M = 1000.0


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
