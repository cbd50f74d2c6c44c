"""Which of the traces in a picture is the shaft: candidates, rivals, walls, and beginnings inside the picture."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Self

import cv2
import numpy as np
from numpy.typing import NDArray

from labrig.errors import MeasurementRefusedError
from labrig.vision.picture import Picture
from labrig.vision.shaft_edges import LEAST_POINTS
from labrig.vision.shaft_trace import Trace, Widths

FloatArray = NDArray[np.float64]

# A shaft that begins further inside the picture than this does not come from the border.
LARGEST_GAP_MM = 10.0
# A second shaft of this length and this share of the first shaft's strength makes the picture ambiguous.
_RIVAL_MM, _RIVAL_STRENGTH = 8.0, 0.4
# A bar is a wall if it is off a straight line by at most this share of its length, and ends this close to the border on
# both sides.
_STRAIGHT, _AT_BORDER_MM = 0.02, 3.0
# A shaft that begins inside the picture comes out of an edge if the grey values on both sides of it differ, between
# these distances before and behind its beginning, by this share of its contrast.
_EDGE_FROM_MM, _EDGE_TO_MM, _EDGE_CONTRAST = 1.5, 4.0, 0.25
_EDGE_SAMPLES = 9
# The weaker side of a shaft has this share of the contrast of the stronger one.
_LEAST_SIDE = 0.4


def choose_shaft(
    traces: tuple[Trace, ...], widths: Widths, original_px: Callable[[FloatArray], FloatArray]
) -> Trace:
    """Return the shaft that enters at the border.

    Raises
    ------
    MeasurementRefusedError
        If a second shaft enters, or if the first does not come from the border.
    """
    first = traces[0]
    gap_mm = _measure_gap_mm(first, widths)
    if gap_mm > LARGEST_GAP_MM:
        raise MeasurementRefusedError(
            f"the shaft begins {gap_mm:.1f} mm inside the picture, and {LARGEST_GAP_MM:g} mm is the most for a shaft "
            "that comes from the border and not out of an edge"
        )
    if len(first.points) < LEAST_POINTS:
        u, v = original_px(first.points[-1:])[0]
        raise MeasurementRefusedError(
            f"what enters the picture is not a shaft: it ends at ({u:.0f}, {v:.0f}) px"
        )
    for other in traces[1:]:
        if _is_rival(first, other, widths):
            starts = original_px(np.array([first.points[0], other.points[0]]))
            places = " and ".join(f"({u:.0f}, {v:.0f})" for u, v in starts)
            raise MeasurementRefusedError(
                f"two shafts enter the picture, at {places} px, and one is expected"
            )
    return first


def find_only_shaft(traces: tuple[Trace, ...], picture: Picture, widths: Widths) -> Trace | None:
    """Return the shaft that comes from the border or out of an edge, if exactly one does; walls and edges are none."""
    candidates = [trace for trace in traces if _is_candidate(trace, picture, widths)]
    if not candidates:
        return None
    first = max(candidates, key=lambda trace: trace.weight)
    return None if any(_is_rival(first, other, widths) for other in candidates) else first


def _is_candidate(trace: Trace, picture: Picture, widths: Widths) -> bool:
    if len(trace.points) < LEAST_POINTS or _is_wall(trace, picture, widths):
        return False
    levels = _Levels.beside(trace, picture, widths)
    return levels.has_two_sides() and (
        _measure_gap_mm(trace, widths) <= LARGEST_GAP_MM or levels.begin_at_an_edge()
    )


def _measure_gap_mm(trace: Trace, widths: Widths) -> float:
    return float(trace.points[0, 0] + 0.5) / widths.px_per_mm


def _is_rival(first: Trace, other: Trace, widths: Widths) -> bool:
    """Return whether another trace is a shaft of its own.

    A slanting sheath can yield two traces of one shaft, so only the part counts that lies apart from the first.
    """
    away = np.linalg.norm(other.points[:, None] - first.points[None], axis=2).min(axis=1)
    apart = away >= widths.widest_px / 2.0
    steps_mm = np.hypot(*np.diff(other.points, axis=0).T) / widths.px_per_mm
    if steps_mm[apart[1:]].sum() < _RIVAL_MM:
        return False
    return float(np.median(other.responses[apart])) >= _RIVAL_STRENGTH * first.strength


def _is_wall(trace: Trace, picture: Picture, widths: Widths) -> bool:
    """Return whether a trace is straight and runs from border to border."""
    ends = trace.points[[0, -1]]
    to_border = np.minimum(ends + 0.5, np.array(picture.shape[::-1]) - 0.5 - ends).min(axis=1)
    if (to_border > _AT_BORDER_MM * widths.px_per_mm).any():
        return False
    chord, offsets = ends[1] - ends[0], trace.points - ends[0]
    away = np.abs(chord[0] * offsets[:, 1] - chord[1] * offsets[:, 0]) / (chord @ chord)
    return bool(np.quantile(away, 0.9) < _STRAIGHT)


@dataclass(frozen=True, eq=False)
class _Levels:
    """Grey levels on both sides (2,) of a trace: along it, before and behind its beginning; and of its core."""

    along: FloatArray
    before: FloatArray
    behind: FloatArray
    core: float

    @classmethod
    def beside(cls, trace: Trace, picture: Picture, widths: Widths) -> Self:
        """Return the levels beside a trace of at least `LEAST_POINTS` points."""
        tangents = np.gradient(trace.points, axis=0)
        tangents /= np.linalg.norm(tangents, axis=1)[:, None]
        normals = np.column_stack((-tangents[:, 1], tangents[:, 0]))
        away = 0.5 * widths.widest_px + widths.needle_px
        start, along = trace.points[0], trace.points[LEAST_POINTS - 1] - trace.points[0]
        along = along / np.linalg.norm(along)
        reach = np.linspace(_EDGE_FROM_MM, _EDGE_TO_MM, _EDGE_SAMPLES)[:, None] * widths.px_per_mm * along
        asides = [side * away * np.array([-along[1], along[0]]) for side in (1.0, -1.0)]
        return cls(
            np.array([_read_level(picture, trace.points + side * away * normals) for side in (1.0, -1.0)]),
            np.array([_read_level(picture, start + aside - reach) for aside in asides]),
            np.array([_read_level(picture, start + aside + reach) for aside in asides]),
            _read_level(picture, trace.points),
        )

    def has_two_sides(self) -> bool:
        """Return whether it is lighter on both sides: the edge of something dark is so on one."""
        contrast = self.along - self.core
        return bool(contrast.min() >= _LEAST_SIDE * contrast.max() > 0.0)

    def begin_at_an_edge(self) -> bool:
        """Return whether the grey values change at the beginning, on both sides and in the same sense."""
        steps = (self.behind - self.before) / (self.behind - self.core).clip(1.0)
        return bool(np.abs(steps).min() >= _EDGE_CONTRAST and steps.prod() > 0.0)


def _read_level(picture: Picture, places: FloatArray) -> float:
    u, v = (np.ascontiguousarray(column, dtype=np.float32) for column in places.T)
    return float(np.median(cv2.remap(picture, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)))
