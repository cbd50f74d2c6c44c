"""The needle's tip in a picture, by a template turned to its heading; to a tenth of a pixel.

Normalised cross-correlation finds the place; a fit of place and heading refines it (`tip_fit`). An upright
template is 2.4 px off if the heading differs by 10 degrees, so the template is turned first. A bevel that was turned
over by half a turn appears mirrored, and its template is mirrored too.

The search runs in a smaller picture, and the fit at its best places in full size. Glints do not turn with the needle
and are removed first: a grey opening removes what is bright and narrower than the needle. A window without contrast
correlates with anything and is never a tip.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from labrig.errors import InputError, PictureError
from labrig.protocol.model import Model
from labrig.text import round_down
from labrig.vision.picture import Mask, Picture, require_size, size_of
from labrig.vision.template import LEAST_SIDE_PX, TipTemplate, remove_glints, require_grey, wrap_angle
from labrig.vision.tip_fit import Placement, Point

_Window = tuple[slice, slice]

# Standard deviation of the place of an accepted tip [px]: 0.1 along u and v each, the limit of
# `python -m tests.benchmarks tip`. It rests on drawn pictures of the simulated camera, searched with a template that
# was cut from such a picture; how well a template of another camera or needle is marked is not in it.
TIP_SIGMA_PX = 0.14
RIM_PX = 25.0
"""A tip closer to the rim of the picture than this is not found."""
# A window with less than this share of the template's standard deviation is flat.
_FLAT = 0.4
# Fewest pixels of the template's side in the smaller picture, and how often a picture is halved at most; a region of
# fewer pixels than these is halved once: the time suffices.
_LEAST_SMALL_SIDE_PX, _MOST_HALVINGS, _SMALL_AREA_PX = 10, 2, 40_000
# Number of places that are fitted in full size, and by how much less than the best of them one may correlate before.
_PLACES, _HOPELESS = 3, 0.3
# Reach of a fit around its place, in diagonals of the template.
_REACH, _REACH_PX = 0.75, 3.0
# A fit that moves the tip by more than this share of the template's side has found something else.
_MOST_MOVED = 0.25
# Two places within this share of the template's side are the same.
_SAME_PLACE = 0.6
# An accepted place has this correlation with the fitted template, 1 at best, and so much more than the next best one.
# A predicted heading is refined by no more than this turn.
_LEAST_SCORE, _LEAST_DISTINCTNESS = 0.9, 0.05
_MOST_TURNED_RAD = math.radians(15.0)
# Headings tried if none is predicted, from -96 to 96 degrees.
_HEADINGS_RAD = tuple(math.radians(12.0 * step) for step in range(-8, 9))


def is_off_rim(u: float, v: float, size: tuple[int, int]) -> bool:
    """Return whether a tip at a pixel is far enough from the rim of a picture (width, height) to be found."""
    width, height = size
    return RIM_PX <= u <= width - 1 - RIM_PX and RIM_PX <= v <= height - 1 - RIM_PX


class TipFix(Model):
    """The tip found in a picture; unknown values are None.

    Attributes
    ----------
    accepted : bool
    reason : str or None
        Why it is refused, as a sentence with value and limit.
    tip_px : (float, float) or None
        Set if accepted.
    heading_rad : float or None
        Set if accepted: the refined heading, right within a degree or two.
    score, distinctness : float or None
        Correlation, and its difference to the next best place; also set if they are the reason for the refusal.
    """

    accepted: bool
    reason: str | None
    tip_px: Point | None = None
    heading_rad: float | None = None
    score: float | None = None
    distinctness: float | None = None


def locate_tip(
    image: Picture,
    template: TipTemplate,
    *,
    near_px: Point | None = None,
    heading_rad: float | None = None,
    roll_rad: float | None = None,
    region_px: float = 120.0,
    mask: Mask | None = None,
) -> TipFix:
    """Find the tip in a picture.

    Parameters
    ----------
    image : ndarray of uint8, (H, W) or (H, W, 3)
    template : TipTemplate
    near_px : (float, float) or None
        Predicted pixel of the tip. None: the whole picture is searched.
    heading_rad : float or None
        Predicted heading, within about 7 degrees. None: all from -96 to 96 degrees are tried.
    roll_rad : float or None
        Roll of the bevel. None: as in the template and turned over are both tried.
    region_px : float
        Side of the square around `near_px` that is searched.
    mask : ndarray of bool (H, W) or None
        Pixels to leave out: a window that contains such a pixel is not a tip.

    Returns
    -------
    TipFix
        Refused if the picture does not show exactly one tip.

    Raises
    ------
    PictureError
        For a picture that is not of 8 bits, is smaller than the template, or does not have the size of the mask.
    InputError
        For a prediction that is not finite, or a region that is not positive.
    """
    grey = require_grey(image)
    require_size(grey, None if mask is None else size_of(mask), "the mask")
    _check(grey, template, (*(near_px or ()), heading_rad or 0.0, roll_rad or 0.0), region_px)
    window = (slice(None), slice(None))
    if near_px is not None:
        # The template may be larger on one side of its tip than on the other.
        window = _cut_window(grey, near_px, 0.5 * max(region_px, *template.picture.shape))
    part, left, top = grey[window], window[1].start or 0, window[0].start or 0
    if min(part.shape) < LEAST_SIDE_PX:
        return TipFix(accepted=False, reason="The tip is predicted outside of the picture.")
    views = _list_views(template, roll_rad, heading_rad)
    starts = _find_starts(part, None if mask is None else mask[window], views)
    if not starts:
        return TipFix(
            accepted=False,
            reason="Nothing in what is searched is like the template: it is dark, flat or masked.",
        )
    fitted = [(_fit(part, start), start) for start in starts]
    found, start = max(fitted, key=lambda pair: 0.0 if pair[0] is None else pair[0].score)
    if found is None:
        # Without a score: which places are tried is a matter of rounding where none is any good.
        return TipFix(accepted=False, reason="The template cannot be fitted to any place.")
    rivals = (rival for rival, _ in fitted if rival is not None and _is_apart(rival, found))
    distinctness = found.score - max((rival.score for rival in rivals), default=0.0)
    reason = _judge(found, distinctness, start, predicted=heading_rad is not None)
    if reason is not None:
        return TipFix(accepted=False, reason=reason, score=found.score, distinctness=distinctness)
    return TipFix(
        accepted=True,
        reason=None,
        tip_px=found.place.shift(left, top).lands_px,
        heading_rad=wrap_angle(found.template.heading_rad + found.place.turn_rad),
        score=found.score,
        distinctness=distinctness,
    )


@dataclass(frozen=True, eq=False)
class _Match:
    """A place of a template, one side of the bevel, in the part that is searched, and the correlation there."""

    template: TipTemplate
    place: Placement
    score: float


def _find_starts(
    picture: Picture, mask: Mask | None, views: Sequence[tuple[TipTemplate, float]]
) -> list[_Match]:
    """Return the most likely places of templates, each turned by an angle, as a smaller picture shows them, best first.

    Places of the same side of the bevel are apart from one another.
    """
    side_px = min(views[0][0].picture.shape)
    halvings = _MOST_HALVINGS if picture.size > _SMALL_AREA_PX else 1
    halvings = max(0, min(halvings, int(math.log2(side_px / _LEAST_SMALL_SIDE_PX))))
    times = 2**halvings
    masked = None if mask is None else mask.astype(np.uint8) * np.uint8(255)
    for _ in range(halvings):
        picture = _halve(picture)
        masked = None if masked is None else _halve(masked)
    picture = remove_glints(picture, side_px / times)
    found: list[_Match] = []
    for template, turn_rad in views:
        patch, tip_px = _turn_template(template, turn_rad, times)
        scores = _correlate(picture, masked, patch)
        reach = round(_SAME_PLACE * side_px / times)
        for _ in range(_PLACES if scores.size else 0):
            _, score, _, (u, v) = cv2.minMaxLoc(scores)
            if score <= 0.0:
                break
            scores[max(0, v - reach) : v + reach + 1, max(0, u - reach) : u + reach + 1] = -1.0
            # Pixel centres are integers in both pictures.
            lands_px = ((u + tip_px[0] + 0.5) * times - 0.5, (v + tip_px[1] + 0.5) * times - 0.5)
            found.append(_Match(template, Placement(lands_px, turn_rad), score))
    return _keep_best(found)


def _halve(picture: Picture) -> Picture:
    rows, columns = (n // 2 for n in picture.shape)
    whole = picture[: 2 * rows, : 2 * columns]
    return np.asarray(cv2.resize(whole, (columns, rows), interpolation=cv2.INTER_AREA), np.uint8)


def _turn_template(template: TipTemplate, turn_rad: float, times_smaller: int) -> tuple[Picture, Point]:
    """Return a template without glints, turned and reduced, and its tip's pixel; the rim repeats itself outwards."""
    picture = template.plain
    # A square of the mean side holds the most of an oblong at any turn.
    side = round(sum(picture.shape) / (2 * times_smaller))
    turn = Placement((0.0, 0.0), turn_rad).rotation() / times_smaller
    middle = 0.5 * (side - 1) - turn @ (0.5 * np.array(picture.shape[::-1]) - 0.5)
    if times_smaller > 1:
        picture = np.asarray(cv2.blur(picture, (times_smaller, times_smaller)), np.uint8)
    turned = cv2.warpAffine(
        picture,
        np.column_stack((turn, middle)),
        (side, side),
        flags=cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_REPLICATE,
    )
    u, v = (turn @ template.tip_px + middle).tolist()
    return np.asarray(turned, np.uint8), (u, v)


def _correlate(picture: Picture, masked: Picture | None, patch: Picture) -> NDArray[np.float32]:
    """Return the correlation for each place of the patch's first pixel; -1 if the window is flat or masked."""
    (height, width), (rows, columns) = picture.shape, patch.shape
    if height < rows or width < columns:
        return np.empty((0, 0), np.float32)
    scores = np.asarray(cv2.matchTemplate(picture, patch, cv2.TM_CCOEFF_NORMED), np.float32)
    inside = (slice(height - rows + 1), slice(width - columns + 1))
    size, first = (columns, rows), (0, 0)
    mean = cv2.boxFilter(picture, cv2.CV_32F, size, anchor=first)[inside]
    square = cv2.sqrBoxFilter(picture, cv2.CV_32F, size, anchor=first)[inside]
    least = (_FLAT * float(cv2.meanStdDev(patch)[1][0, 0])) ** 2
    # A NaN fails the comparison, so it is not a tip either.
    usable = (square - mean * mean >= least) & (scores <= 1.01)
    if masked is not None:
        usable &= cv2.boxFilter(masked, cv2.CV_32F, size, anchor=first)[inside] <= 0.0
    scores[~usable] = -1.0
    return scores


def _fit(picture: Picture, start: _Match) -> _Match | None:
    """Fit place and heading of a match together, first without glints; None if that diverges."""
    template = start.template
    reach_px = _REACH * float(np.hypot(*template.picture.shape)) + _REACH_PX
    window = _cut_window(picture, start.place.lands_px, reach_px)
    part, left, top = picture[window], window[1].start, window[0].start
    plain = remove_glints(part, min(template.picture.shape))
    rough = template.coarse_fit.fit(plain, start.place.shift(-left, -top))
    close = None if rough is None else template.close_fit.fit(part, rough)
    if close is None:
        return None
    return _Match(template, close.shift(left, top), template.coarse_fit.correlate(plain, close))


def _cut_window(picture: Picture, centre_px: Point, reach_px: float) -> _Window:
    """Return the part of a picture within reach of a pixel."""
    (left, right), (top, bottom) = (
        (max(0, math.floor(at - reach_px)), max(0, min(side, math.ceil(at + reach_px) + 1)))
        for at, side in zip(centre_px, size_of(picture), strict=True)
    )
    return slice(top, bottom), slice(left, right)


def _judge(found: _Match, distinctness: float, start: _Match, *, predicted: bool) -> str | None:
    """Return why a fitted match is not accepted as the tip, or None."""
    if found.score < _LEAST_SCORE:
        return f"The score is {round_down(found.score, 3)}, and {_LEAST_SCORE:g} is the least."
    if distinctness < _LEAST_DISTINCTNESS:
        return (
            f"The best place scores {round_down(distinctness, 3)} more than the next, "
            f"and {_LEAST_DISTINCTNESS:g} is the least: they cannot be told apart."
        )
    # A heading that was only tried may be far from the needle's; a predicted heading may not.
    turned_rad = abs(wrap_angle(found.place.turn_rad - start.place.turn_rad)) if predicted else 0.0
    most_moved = _MOST_MOVED if predicted else 2.0 * _MOST_MOVED
    moved_px = math.dist(found.place.lands_px, start.place.lands_px)
    if turned_rad > _MOST_TURNED_RAD or moved_px > most_moved * min(start.template.picture.shape):
        return (
            f"The fit went {moved_px:.1f} px and {math.degrees(turned_rad):.1f} degrees away from the best place, "
            "so it is not to be trusted; a heading that was given may be wrong."
        )
    return None


def _keep_best(matches: Iterable[_Match]) -> list[_Match]:
    """Return the best matches, each apart from every better one of the same side of the bevel."""
    kept: list[_Match] = []
    for match in sorted(matches, key=lambda match: -match.score):
        same_side = (better for better in kept if better.template is match.template)
        if all(_is_apart(match, better) for better in same_side):
            kept.append(match)
    return [match for match in kept[:_PLACES] if match.score >= kept[0].score - _HOPELESS]


def _is_apart(match: _Match, other: _Match) -> bool:
    """Return whether two matches are too far apart to be the same tip."""
    reach_px = _SAME_PLACE * float(min(match.template.picture.shape))
    return math.dist(match.place.lands_px, other.place.lands_px) > reach_px


def _list_views(
    template: TipTemplate, roll_rad: float | None, heading_rad: float | None
) -> list[tuple[TipTemplate, float]]:
    """Return the sides of the bevel that may be seen, each turned by the angles to try [rad]."""
    both = (template, template.mirrored)
    sides = both if roll_rad is None else (both[not template.has_same_side(roll_rad)],)
    headings = _HEADINGS_RAD if heading_rad is None else (heading_rad,)
    return [(side, wrap_angle(heading - side.heading_rad)) for side in sides for heading in headings]


def _check(grey: Picture, template: TipTemplate, numbers: Sequence[float], region_px: float) -> None:
    (height, width), (rows, columns) = grey.shape, template.picture.shape
    if rows > height or columns > width:
        raise PictureError(
            f"the template has {columns} x {rows} pixels, larger than the picture, {width} x {height}",
            "use the camera setting that the template was made with",
        )
    if not (np.isfinite(numbers).all() and math.isfinite(region_px) and region_px > 0.0):
        raise InputError(
            f"the prediction {tuple(numbers)} or the region of {region_px:g} px is not a number that can be used",
            "predict from a good frame",
        )
