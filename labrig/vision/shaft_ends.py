"""The ends of a straightened shaft: its longest unbroken run, the sheath's tip and the needle's tip."""

import numpy as np
from numpy.typing import NDArray

from labrig.errors import MeasurementRefusedError
from labrig.text import round_down
from labrig.vision.shaft_edges import Edges, measure_gel_level, measure_side_levels, smooth_rows, take_sides
from labrig.vision.shaft_trace import Widths

FloatArray = NDArray[np.float64]

# A hole in the shaft longer than this ends it.
LARGEST_HOLE_MM = 3.0
# Sheath and needle must each be visible over this length to be distinguished.
_LEAST_PIECE_MM = 1.0
# Rows whose relative width differs more than this from the median are not shaft but bevel, or a bubble at an edge.
WIDTH_TOLERANCE = 0.25
# At least this share of a sheath's rows have its width. In drawn pictures it is 0.99 and more of a sheath alone, and
# 0.80 to 0.84 where two shafts lie over one another.
_EVEN_SHEATH = 0.9
# The tip is where the darkness falls to this share of that of the shaft's last stretch. The share is low because a
# bevel fades before it ends. Beside something brighter than the gel by the first share, what is not darker than the
# other side by the second share is gel. Smoothing and reach across are in needle stated.
_TIP_LEVEL = 0.3
_WALL, _GEL = 0.3, 0.15
_TIP_REFERENCE_MM = 5.0
_TIP_GAP_MM = 1.0
_TIP_SIGMA = 0.1
_TIP_REACH = 0.6
# The tip fades from where the darkness has this share.
_FADE_LEVEL = 0.5
# Brightness steps between two levels over the first length each, the second apart, up to the third from the tip.
_LEVEL_MM, _STEP_MM, _NEAR_TIP_MM = 1.0, 0.5, 2.5


def find_longest_run(
    counts: NDArray[np.bool_], px_per_mm: float, hole_mm: float = LARGEST_HOLE_MM
) -> NDArray[np.bool_]:
    """Return the longest run of `counts`; a hole longer than `hole_mm` ends a run."""
    rows = np.flatnonzero(counts)
    if not len(rows):
        raise MeasurementRefusedError("no stretch of the shaft shows both edges")
    pieces = np.split(rows, np.flatnonzero(np.diff(rows) > hole_mm * px_per_mm) + 1)
    run = np.zeros_like(counts)
    run[max(pieces, key=len)] = True
    return run


def find_sheath_end(width_mm: FloatArray, run: NDArray[np.bool_], stated: Widths) -> float:
    """Return the fractional row at which the width drops from the sheath's to the needle's; 0 without a sheath.

    Raises
    ------
    MeasurementRefusedError
        If a sheath is stated and the width does not drop: no needle is out, or the picture shows no sheath. If the
        sheath's tip is hidden, or what is as wide as a sheath is not so evenly.
    """
    if stated.sheath_mm is None:
        return 0.0
    rows = np.flatnonzero(run)
    width = width_mm[rows]
    piece = max(1, round(_LEAST_PIECE_MM * stated.px_per_mm))
    step = _find_largest_step(width, piece)
    ratio = np.sqrt(stated.sheath_mm / stated.needle_mm)
    if step is None or np.median(width[:step]) < ratio * np.median(width[step:]):
        seen = float(np.median(width))
        told = f"the sheath is {stated.sheath_mm} mm wide and the needle {stated.needle_mm} mm"
        if seen > np.sqrt(stated.sheath_mm * stated.needle_mm):
            raise MeasurementRefusedError(
                f"no needle is seen beyond the sheath: the shaft is {seen:.2f} mm wide to its end; {told}"
            )
        raise MeasurementRefusedError(
            f"no sheath is seen: the longest piece of shaft with both edges is {seen:.2f} mm wide; {told}"
        )
    usual = float(np.median(width[:step]))
    level = 0.5 * (usual + float(np.median(width[step:])))
    near = max(step - piece // 2, 1)
    after = near + int(np.argmax(width[near:] < level))
    even = float(np.mean(np.abs(width[:after] - usual) <= WIDTH_TOLERANCE * usual))
    if even < _EVEN_SHEATH:
        raise MeasurementRefusedError(
            f"{round_down(100.0 * even, 1)} % of the sheath's rows are {usual:.2f} mm wide within "
            f"{100.0 * WIDTH_TOLERANCE:.0f} %, and {100.0 * _EVEN_SHEATH:.0f} % is the least: something lies over it"
        )
    hidden_mm = float(rows[after] - rows[after - 1]) / stated.px_per_mm
    if hidden_mm > LARGEST_HOLE_MM:
        raise MeasurementRefusedError(
            f"the sheath's tip is hidden: no edges are seen over {hidden_mm:.1f} mm, "
            f"and {LARGEST_HOLE_MM:g} mm is the most"
        )
    return float(
        rows[after - 1]
        + _interpolate(width[after - 1], width[after], level) * (rows[after] - rows[after - 1])
    )


def _interpolate(before: float, after: float, level: float) -> float:
    """Return the fraction (0 to 1) of the way from `before` down to `after` at which `level` is reached."""
    return float(np.clip((before - level) / max(before - after, 1e-6), 0.0, 1.0))


def _find_largest_step(width: FloatArray, piece: int) -> int | None:
    """Return the cut at which two constants fit best, each over at least `piece` widths; None if there are too few."""
    if len(width) < 2 * piece + 1:
        return None
    count = np.arange(1, len(width))
    before = np.cumsum(width)[:-1]
    gain = before**2 / count + (width.sum() - before) ** 2 / (len(width) - count)
    return piece + int(np.argmax(gain[piece - 1 : len(gain) - piece + 1]))


def find_needle_end(
    strip: NDArray[np.float32], edges: Edges, run: NDArray[np.intp], widths: Widths
) -> tuple[float, float]:
    """Return where the darkness ends after `run`, and over how many rows it fades.

    It is a fractional row, the strip's last if the darkness does not end.
    """
    middle, reach = strip.shape[1] // 2, int(np.ceil(_TIP_REACH * widths.needle_px))
    smooth = smooth_rows(strip, _TIP_SIGMA * widths.needle_px)
    darkest = smooth[:, middle - reach : middle + reach + 1].min(axis=1)
    reference = run[run > run[-1] - _TIP_REFERENCE_MM * widths.px_per_mm]
    contrast = float(np.median((edges.gel - edges.core)[reference]))
    darkness = (measure_gel_level(smooth, widths) - darkest) / contrast
    # Beside a bright wall gel looks dark, but not against the gel on its other side.
    darker, brighter = measure_side_levels(smooth, widths)
    at_wall = (brighter - np.median(edges.gel[run]) > _WALL * contrast) & (darker - darkest < _GEL * contrast)
    dark = np.flatnonzero((darkness >= _TIP_LEVEL) & ~at_wall)
    dark = np.concatenate((run[-1:], dark[dark > run[-1]]))
    holes = np.flatnonzero(np.diff(dark) > _TIP_GAP_MM * widths.px_per_mm)
    last = int(dark[holes[0]] if len(holes) else dark[-1])
    if last + 1 >= len(strip):
        return float(last), 0.0
    half = int(np.flatnonzero(darkness[: last + 1] >= _FADE_LEVEL).max(initial=0))
    row, before = (
        place + _interpolate(darkness[place], darkness[place + 1], level)
        for place, level in ((last, _TIP_LEVEL), (half, _FADE_LEVEL))
    )
    return row, row - before


def measure_brightening(strip: NDArray[np.float32], tip: float, widths: Widths) -> float:
    """Return by which share both sides of a strip become brighter near the tip, as at the edge of a bright wall."""
    scale = widths.px_per_mm
    length, apart = max(1, round(_LEVEL_MM * scale)), round(_STEP_MM * scale)
    reach = round(_NEAR_TIP_MM * scale) + length + apart // 2
    near = strip[max(0, int(tip) - reach) : int(tip) + reach + 1]
    if len(near) < 2 * length + apart:
        return 0.0
    rises = []
    for side in take_sides(near, widths):
        sums = np.cumsum(np.median(side, axis=1), dtype=np.float64)
        levels = (sums[length:] - sums[:-length]) / length
        before, behind = levels[: -length - apart], levels[length + apart :]
        rises.append(float((behind / before.clip(1.0) - 1.0).max(initial=0.0)))
    return min(rises)
