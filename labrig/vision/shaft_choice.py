"""Which of the traces in a picture is the shaft: rivals, walls, and edges of something dark."""

from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray

from labrig.errors import MeasurementRefusedError
from labrig.vision.picture import Picture
from labrig.vision.shaft_edges import LEAST_POINTS
from labrig.vision.shaft_trace import Trace, Widths

FloatArray = NDArray[np.float64]

# A shaft without a sheath that begins further inside the picture than this does not come from the border.
LARGEST_GAP_MM = 10.0
# A second shaft of this length and this share of the first shaft's strength makes the picture ambiguous.
_RIVAL_MM, _RIVAL_STRENGTH = 8.0, 0.4
# A bar is a wall if it is off a straight line by at most this share of its length, and ends this close to the border on
# both sides.
_STRAIGHT, _AT_BORDER_MM = 0.02, 3.0
# A shaft's own level is the darkest of its middle and of the places so many widths to either side of it.
_CORE = 0.3
# The weaker side of a shaft has this share of the contrast of the stronger one.
_LEAST_SIDE = 0.4


def choose_shaft(
    traces: tuple[Trace, ...],
    picture: Picture,
    widths: Widths,
    original_px: Callable[[FloatArray], FloatArray],
) -> Trace:
    """Return the shaft among traces of a turned picture, likeliest first; walls and the edges of dark things are none.

    A shaft whose sheath is stated may come out of a holder or a gel's edge inside the picture, since its length counts
    from the sheath's tip. Another one comes from the border.

    Raises
    ------
    MeasurementRefusedError
        If there is none, or a second one, or if it does not come from the border.
    """
    shafts = [trace for trace in traces if _may_be_shaft(trace, picture, widths)]
    if not shafts:
        u, v = original_px(traces[0].points[-1:])[0]
        raise MeasurementRefusedError(
            f"what enters the picture is not a shaft: it ends at ({u:.0f}, {v:.0f}) px"
        )
    alone = (one for one in shafts if not any(_is_rival(one, other, widths) for other in shafts))
    first = next(alone, None)
    if first is None:
        starts = original_px(np.array([trace.points[0] for trace in shafts[:2]]))
        places = " and ".join(f"({u:.0f}, {v:.0f})" for u, v in starts)
        raise MeasurementRefusedError(f"two shafts enter the picture, at {places} px, and one is expected")
    gap_mm = float(first.points[0, 0] + 0.5) / widths.px_per_mm
    if widths.sheath_mm is None and gap_mm > LARGEST_GAP_MM:
        raise MeasurementRefusedError(
            f"the shaft begins {gap_mm:.1f} mm inside the picture, and {LARGEST_GAP_MM:g} mm is the most for a shaft "
            "without a sheath, whose length counts from the border"
        )
    return first


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


def _may_be_shaft(trace: Trace, picture: Picture, widths: Widths) -> bool:
    """Return whether a trace is a bar that is lighter on both sides, and no straight one from border to border."""
    points = trace.points
    if len(points) < LEAST_POINTS:
        return False
    chord, offsets = points[-1] - points[0], points - points[0]
    bend = np.quantile(np.abs(chord[0] * offsets[:, 1] - chord[1] * offsets[:, 0]) / (chord @ chord), 0.9)
    ends = points[[0, -1]] + 0.5
    to_border = np.minimum(ends, np.array(picture.shape[::-1]) - ends).min(axis=1)
    if bend < _STRAIGHT and (to_border <= _AT_BORDER_MM * widths.px_per_mm).all():
        return False
    tangents = np.gradient(points, axis=0)
    normals = np.column_stack((-tangents[:, 1], tangents[:, 0])) / np.hypot(*tangents.T)[:, None]
    away_px = 0.5 * widths.widest_px + widths.needle_px
    aside_px = _CORE * widths.needle_px
    # A glint may lie along the middle.
    core = min(_read_level(picture, points + across * normals) for across in (-aside_px, 0.0, aside_px))
    sides = [_read_level(picture, points + across * normals) for across in (-away_px, away_px)]
    return min(sides) - core >= _LEAST_SIDE * (max(sides) - core) > 0.0


def _read_level(picture: Picture, places: FloatArray) -> float:
    u, v = np.ascontiguousarray(places.T, dtype=np.float32)
    return float(np.median(cv2.remap(picture, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)))
