"""The needle's shaft in a picture: centre line, sheath's tip and needle's tip, to a fraction of a pixel.

The shaft is darker than the gel and enters at the border from which the insertion comes. It is traced coarsely
(`shaft_trace`), straightened, and measured by its two edges (`shaft_edges`). This is done twice, so that the second
strip follows the shaft itself. The sheath's tip is where the width drops from the sheath's to the needle's; the
needle's tip is where the darkness ends (`shaft_ends`).

A shaft may also begin inside the picture, where it comes out of something with an edge: the gel's own edge, a holder, a
wall. A straight bar from border to border is a wall and no second shaft (`shaft_choice`). A bright wall may hide a
stretch of the shaft; a tip at such a wall is refused.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from labrig.errors import MeasurementRefusedError
from labrig.text import round_down
from labrig.vision.picture import Mask, Picture, as_grey, fill_masked, require_contrast
from labrig.vision.plane import PlaneMap
from labrig.vision.shaft_choice import LARGEST_GAP_MM, choose_shaft
from labrig.vision.shaft_edges import (
    LEAST_POINTS,
    Edges,
    Guide,
    find_edges,
    fit_guide,
    measure_light_shift,
    split_light_shift,
    straighten,
)
from labrig.vision.shaft_ends import (
    LARGEST_HOLE_MM,
    WIDTH_TOLERANCE,
    find_longest_run,
    find_needle_end,
    find_sheath_end,
    measure_brightening,
)
from labrig.vision.shaft_trace import Orientation, Trace, Widths, filter_bars, measure_beyond, trace_shafts

FloatArray = NDArray[np.float64]

# A trace may follow an edge of a shining tube, off its middle by half of this excess.
_SHEATH_MARGIN = 1.3
# A guide that ends this close to the border was cut by it.
_BORDER_PX = 2.0
# An end in the last rows of the strip is no end.
_LEAST_ROWS_BEYOND = 2
# How far beyond the traced end the tip is searched for.
_BEYOND_MM = 6.0
# A tip is not believed where the picture becomes brighter than the gel by more than this share: there a wall may hide
# the rest. In photographs without a wall at the tip, uneven light gave up to 0.09.
_HIDING = 0.13
# The last stretch, with whose darkness that ahead of the tip is compared.
_LAST_MM = 8.0
# The stated diameters hold within this factor.
_DIAMETER_FACTOR = 1.7
# Over the first length, in needle diameters, the smoothing along the shaft mixes sheath and needle; over the second,
# the bevel narrows the needle, but too little to be recognised by its width.
_STEP_BLUR = 0.6
_BEVEL_ONSET = 0.6
# A row does not count if a mask comes this close to its middle, in needle diameters.
_MASK_REACH = 0.6
# Both edges must be visible over this share of the needle, and over this length.
_LEAST_MEASURED = 0.5
_LEAST_LENGTH_MM = 1.0


@dataclass(frozen=True, eq=False)
class Shaft:
    """A needle's shaft, from the sheath's tip (or where it enters the picture) to its own tip.

    Attributes
    ----------
    centre_px : ndarray (N, 2)
        The centre line [px] in rows about a pixel apart, without rows in which no edges were found.
    centre_mm : ndarray (N, 2)
        The same in the plane [mm]: the middle of the two edges, each mapped on its own.
        Both are corrected for uneven light, see `shaft_edges`.
    arc_mm : ndarray (N,)
        Arc length of these rows from the entry [mm].
    light_shift_mm : ndarray (N, 2)
        By how much uneven light may still have shifted the centre line [mm], see `shaft_edges`.
    widths_mm : ndarray (N,)
        Distance between the edges in these rows [mm].
    width_mm : float
        Median of the widths.
    entry_px : ndarray (2,)
        The sheath's tip, or where the shaft enters the picture.
    sheathed : bool
        Whether the entry is a sheath's tip.
    sheath_mm : ndarray (M, 2)
        The sheath's centre line in the plane [mm], up to its tip; empty without one.
    tip_px : ndarray (2,)
        The end of the centre line, level with the foremost point of the bevel.
    tip_fade_px : float
        Over which length the shaft's darkness fades before it.
    length_mm : float
        Arc length from the entry to the tip.
    """

    centre_px: FloatArray
    centre_mm: FloatArray
    arc_mm: FloatArray
    light_shift_mm: FloatArray
    widths_mm: FloatArray
    width_mm: float
    entry_px: FloatArray
    sheathed: bool
    sheath_mm: FloatArray
    tip_px: FloatArray
    tip_fade_px: float
    length_mm: float


@dataclass(frozen=True, eq=False)
class _Scene:
    """The turned grey picture, masked pixels filled; the mask (uint8, 255 where masked), or None; and the plane."""

    picture: Picture
    masked: Picture | None
    orientation: Orientation
    plane: PlaneMap

    def px(self, points: FloatArray) -> FloatArray:
        """Return points of the turned picture in the original one."""
        return self.orientation.original_px(points)

    def mm(self, points: FloatArray) -> FloatArray:
        """Return points of the turned picture in the plane."""
        return self.plane.to_mm(self.px(points))

    def edges(self, guide: Guide, widths: Widths) -> tuple[NDArray[np.float32], Edges]:
        """Return the strip along a guide and its edges; rows that a mask touches do not count."""
        strip = straighten(self.picture, guide, widths)
        edges = find_edges(strip, widths)
        if self.masked is None:
            return strip, edges
        middle, reach = strip.shape[1] // 2, int(np.ceil(_MASK_REACH * widths.needle_px))
        touched = (
            straighten(self.masked, guide, widths)[:, middle - reach : middle + reach + 1].max(axis=1) > 0.0
        )
        return strip, replace(edges, counts=edges.counts & ~touched)


def locate_shaft(
    image: Picture,
    plane: PlaneMap,
    diameter_mm: float,
    sheath_diameter_mm: float | None,
    *,
    mask: Mask | None = None,
    needle_inside: bool = False,
) -> Shaft:
    """Find the shaft in a picture.

    Parameters
    ----------
    image : ndarray of uint8, (H, W) or (H, W, 3)
    plane : PlaneMap
    diameter_mm : float
        Of the needle, within a factor of about 1.5.
    sheath_diameter_mm : float or None
        Up to four times the needle's; None if the picture shows no sheath.
    mask : ndarray of bool (H, W), optional
        Pixels that are not the needle.
    needle_inside : bool, optional
        Whether the shaft is a sheath that still holds its needle: what lies ahead of its blunt end, such as a bubble,
        is not judged here but by the end of each stripe along it.

    Raises
    ------
    MeasurementRefusedError
        If the picture does not show exactly one shaft with its tip and, if stated, its sheath. The message says
        what it shows instead.
    """
    require_contrast(image)
    turn = Orientation.of(image, plane.insertion)
    scene = _Scene(
        turn.picture(fill_masked(as_grey(image), mask)),
        None if mask is None else turn.picture(mask.astype(np.uint8) * np.uint8(255)),
        turn,
        plane,
    )
    widths = Widths(diameter_mm, sheath_diameter_mm, 1.0 / plane.mm_per_px)
    bars = filter_bars(scene.picture, widths)
    traces = trace_shafts(bars, from_border=sheath_diameter_mm is None)
    trace = choose_shaft(traces, scene.picture, widths, scene.px)
    # What hides a stretch of the shaft does not end it.
    hole_mm = LARGEST_HOLE_MM + trace.hidden_mm
    shaft, last, tip = _measure(scene, _refine_guide(scene, trace, widths, hole_mm), widths, hole_mm)
    share, most = measure_beyond(bars, tip, last)
    if share > most and not needle_inside:
        u, v = shaft.tip_px
        raise MeasurementRefusedError(
            f"the shaft is lost at ({u:.0f}, {v:.0f}) px, after {shaft.length_mm:.0f} mm, but goes on: what lies "
            f"ahead has {100.0 * share:.0f} % of its darkness, and {100.0 * most:.0f} % is the most"
        )
    return shaft


def _refine_guide(scene: _Scene, trace: Trace, widths: Widths, hole_mm: float) -> Guide:
    """Return a guide along the middle of the shaft's edges, from the border to beyond the tip."""
    scale = widths.px_per_mm
    coarse = fit_guide(trace.points, scale, 0.0, 0.0)
    try:
        edges, run, entry = _find_sheath(scene, coarse, widths, hole_mm)
    except MeasurementRefusedError:
        if widths.sheath_mm is None:
            raise
        edges, run, entry = _find_sheath(scene, coarse, widths, hole_mm, _SHEATH_MARGIN)
    rows = np.flatnonzero(run & _is_bar(edges.width, run, entry))
    rows = rows[rows < rows[-1] - _BEVEL_ONSET * widths.needle_px] if len(rows) else rows
    if len(rows) < max(scale * _LEAST_LENGTH_MM, LEAST_POINTS):
        raise MeasurementRefusedError(
            f"both edges of the shaft are seen over {len(rows) / scale:.1f} mm, and {_LEAST_LENGTH_MM:g} mm is the "
            "least"
        )
    before_mm = rows[0] / scale + LARGEST_GAP_MM
    middle = coarse.at(rows.astype(np.float64), edges.middle[rows])
    guide = fit_guide(middle, scale, before_mm, _BEYOND_MM).inside(
        scene.picture.shape[1], scene.picture.shape[0]
    )
    if len(guide.places) < LEAST_POINTS:
        raise MeasurementRefusedError("the shaft lies on the picture's border")
    return guide


def _find_sheath(
    scene: _Scene, guide: Guide, widths: Widths, hole_mm: float, margin: float = 1.0
) -> tuple[Edges, NDArray[np.bool_], float]:
    """Return the edges within a sheath that is wider by a factor, the longest run of them, and the sheath's end."""
    _, edges = scene.edges(guide, replace(widths, sheath_mm=widths.sheath_mm and margin * widths.sheath_mm))
    run = find_longest_run(edges.counts, widths.px_per_mm, hole_mm)
    return edges, run, find_sheath_end(edges.width / widths.px_per_mm, run, widths)


def _measure(
    scene: _Scene, guide: Guide, widths: Widths, hole_mm: float
) -> tuple[Shaft, FloatArray, FloatArray]:
    """Measure the shaft in the strip along its refined guide.

    Returns
    -------
    Shaft
    last : ndarray (N, 2)
        The places of its last rows in the turned picture.
    tip : ndarray (2,)
        Its end there.
    """
    strip, edges = scene.edges(guide, widths)
    grid = np.arange(len(guide.places), dtype=np.float64)
    left_mm, right_mm = (scene.mm(guide.at(grid, offsets)) for offsets in (edges.left, edges.right))
    width_mm = np.hypot(*(right_mm - left_mm).T)
    run = find_longest_run(edges.counts, widths.px_per_mm, hole_mm)
    entry = find_sheath_end(width_mm, run, widths)
    even = run & _is_bar(width_mm, run, entry)
    sheath, bar = (even & (side > _STEP_BLUR * widths.needle_px) for side in (entry - grid, grid - entry))
    tip, fade = find_needle_end(strip, edges, np.flatnonzero(run), widths)
    if tip >= len(grid) - _LEAST_ROWS_BEYOND:
        raise _no_tip_error(scene, guide.places[-1])
    bar &= grid < tip
    _check_needle(bar, width_mm, tip, widths.needle_mm)
    brighter = measure_brightening(strip, tip, widths)
    if brighter > _HIDING:
        u, v = scene.px(guide.at(np.array([tip]), np.zeros(1)))[0]
        raise MeasurementRefusedError(
            f"the shaft ends at ({u:.0f}, {v:.0f}) px, where the picture becomes {100.0 * brighter:.0f} % brighter, "
            f"and {100.0 * _HIDING:.0f} % is the most for gel: a wall may hide the tip"
        )
    arc_mm = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(scene.mm(guide.places), axis=0).T))))
    entry_arc, tip_arc = np.interp([entry, tip], grid, arc_mm)
    offset = float(np.median(edges.middle[bar][: round(widths.needle_px)]))
    corrected, left = split_light_shift(measure_light_shift(strip, edges, bar, widths.px_per_mm)[bar])
    mm_aside = (right_mm - left_mm)[bar] / edges.width[bar, None]
    turned_ends = guide.at(np.array([entry, tip]), np.array([offset, 0.0]))
    ends = scene.px(turned_ends)
    last = np.flatnonzero(bar)[-round(_LAST_MM * widths.px_per_mm) :]
    shaft = Shaft(
        centre_px=scene.px(guide.at(grid[bar], edges.middle[bar] + corrected)),
        centre_mm=0.5 * (left_mm + right_mm)[bar] + corrected * mm_aside,
        arc_mm=arc_mm[bar] - entry_arc,
        light_shift_mm=left[:, None] * mm_aside,
        widths_mm=width_mm[bar],
        width_mm=float(np.median(width_mm[bar])),
        entry_px=ends[0],
        sheathed=widths.sheath_mm is not None,
        sheath_mm=0.5 * (left_mm + right_mm)[sheath],
        tip_px=ends[1],
        tip_fade_px=fade,
        length_mm=float(tip_arc - entry_arc),
    )
    return shaft, guide.places[last], turned_ends[1]


def _is_bar(width: FloatArray, run: NDArray[np.bool_], entry: float) -> NDArray[np.bool_]:
    """Return which rows (N,) have the median width of the sheath before `entry`, and of the needle after it."""
    beyond = np.arange(len(width)) > entry
    usual = np.where(beyond, _median(width[run & beyond]), _median(width[run & ~beyond]))
    return np.abs(width - usual) <= WIDTH_TOLERANCE * usual


def _median(values: FloatArray) -> float:
    return float(np.median(values)) if len(values) else 0.0


def _no_tip_error(scene: _Scene, end: FloatArray) -> MeasurementRefusedError:
    u, v = scene.px(end[None])[0]
    margin = float(np.min([*(end + 0.5), *(np.array(scene.picture.shape[::-1]) - 0.5 - end)]))
    if margin < _BORDER_PX:
        return MeasurementRefusedError(
            f"the shaft runs out of the picture at ({u:.0f}, {v:.0f}) px, its tip is not seen"
        )
    return MeasurementRefusedError(
        f"the shaft fades without a clear end, it is still dark at ({u:.0f}, {v:.0f}) px"
    )


def _check_needle(bar: NDArray[np.bool_], width_mm: FloatArray, tip: float, needle_mm: float) -> None:
    """Refuse a shaft that is too short, too patchy, or too thick or thin for the needle."""
    rows = np.flatnonzero(bar)
    if len(rows) < 4:
        raise MeasurementRefusedError("no stretch of the needle shows both edges")
    measured = len(rows) / (tip - rows[0] + 1.0)
    if measured < _LEAST_MEASURED:
        raise MeasurementRefusedError(
            f"both edges are seen over {round_down(100.0 * measured, 1)} % of the needle, "
            f"and {100.0 * _LEAST_MEASURED:.0f} % is the least"
        )
    width = float(np.median(width_mm[rows]))
    least, most = needle_mm / _DIAMETER_FACTOR, needle_mm * _DIAMETER_FACTOR
    if not least <= width <= most:
        raise MeasurementRefusedError(
            f"the shaft is {width:.2f} mm wide, and a needle of {needle_mm} mm may look between "
            f"{least:.2f} and {most:.2f} mm wide"
        )
