"""The needle's tip in a picture, by a template turned to its heading; to a tenth of a pixel.

Normalised cross-correlation finds the place; a fit of place and heading refines it (`tip_fit`). An upright
template is 2.4 px off if the heading differs by 10 degrees, so the template is turned first. A bevel that was turned
over by half a turn appears mirrored, and its template is mirrored too.

The search runs in a smaller picture first and then at its best places in full size. Glints do not turn with the needle
and are removed first: a grey opening removes what is bright and narrower than the needle. A window without contrast
correlates with anything and is never a tip.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import cv2
import numpy as np
from numpy.typing import NDArray

from labrig.errors import InputError, PictureError
from labrig.protocol.model import Model
from labrig.text import round_down
from labrig.vision.picture import Picture
from labrig.vision.template import LEAST_SIDE_PX, TipTemplate, remove_glints, require_grey, wrap_angle
from labrig.vision.tip_fit import Placement

FloatArray = NDArray[np.float64]
_Point = tuple[float, float]

# Standard deviation of the place of an accepted tip [px]: 0.1 along u and v each, the limit of
# `python -m tests.benchmarks tip`. It rests on drawn pictures of the simulated camera, searched with a template that
# was cut from such a picture; how well a template of another camera or needle is marked is not in it.
TIP_SIGMA_PX = 0.14
RIM_PX = 25.0
"""A tip closer to the rim of the picture than this is not found."""
# A window with less than this share of the template's standard deviation is flat.
_FLAT = 0.4
# Fewest pixels of the template's side in the smaller picture, and the largest reduction.
_LEAST_SMALL_SIDE_PX = 10
_MOST_TIMES_SMALLER = 4
# A region of fewer pixels is searched at half its size: the time suffices.
_SMALL_AREA_PX = 40_000
# Number of places of the smaller picture that are searched in full size.
_PLACES = 3
# A fit that moves the tip by more than this share of the template's side has found something else.
_MOST_MOVED = 0.25
# Two places within this share of the template's side are the same.
_SAME_PLACE = 0.6
# An accepted place has this correlation with the refined template, 1 at best, and so much more than the next best one.
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
    tip_px: _Point | None = None
    heading_rad: float | None = None
    score: float | None = None
    distinctness: float | None = None


def next_region_px(region_px: float, misses: int, growth: float = 1.6) -> float:
    """Return the side of the square to search after `misses` in a row; `locate_tip` cuts it to the picture."""
    return region_px * float(growth ** min(max(misses, 0), 16))


def locate_tip(
    image: Picture,
    template: TipTemplate,
    *,
    near_px: _Point | None = None,
    heading_rad: float | None = None,
    roll_rad: float | None = None,
    region_px: float = 120.0,
    mask: NDArray[np.bool_] | None = None,
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
    _check(grey, template, mask, (*(near_px or ()), heading_rad or 0.0, roll_rad or 0.0), region_px)
    region = _Region.around(grey, template, near_px, region_px, mask)
    if region is None:
        return TipFix(accepted=False, reason="The tip is predicted outside of the picture.")
    headings = _HEADINGS_RAD if heading_rad is None else (heading_rad,)
    views = [
        _TurnedTemplate(side, wrap_angle(heading - side.heading_rad))
        for side in _list_sides(template, roll_rad)
        for heading in headings
    ]
    places = _find_places(region, views)
    if not places:
        return TipFix(
            accepted=False,
            reason="Nothing in what is searched is like the template: it is dark, flat or masked.",
        )
    # Which of several views fits best is known only after fitting all of them.
    several = len(views) > 1
    tried = [(place, _refine(region, place)) for place in (places if several else places[:1])]
    best, fit = max(tried, key=_get_fitted_score)
    others = map(_get_fitted_score, tried) if several else (place.score for place in places)
    apart = (_is_apart(place, best) for place in places)
    rival = max((score for score, far in zip(others, apart, strict=True) if far), default=0.0)
    reached = _get_fitted_score((best, fit)) if several else best.score
    reason = _judge(fit, best, reached - rival, predicted=heading_rad is not None)
    score, distinctness = best.score if fit is None else fit.score, reached - rival
    if fit is None or reason is not None:
        return TipFix(accepted=False, reason=reason, score=score, distinctness=distinctness)
    (u, v), (left, top) = fit.place.lands_px, region.corner_px
    heading = wrap_angle(best.view.template.heading_rad + fit.place.turn_rad)
    tip = (float(u + left), float(v + top))
    return TipFix(
        accepted=True, reason=None, tip_px=tip, heading_rad=heading, score=score, distinctness=distinctness
    )


@dataclass(frozen=True, eq=False)
class _TurnedTemplate:
    """A template turned to a heading."""

    template: TipTemplate
    turn_rad: float

    def patch(self, times_smaller: int) -> tuple[Picture, FloatArray]:
        """Return the turned picture and the tip's pixel in it; pixels from outside repeat the rim."""
        source = self.template.plain
        height, width = source.shape
        c, s = abs(math.cos(self.turn_rad)), abs(math.sin(self.turn_rad))
        # A square keeps its size; a quarter turn exchanges the sides of an oblong.
        size = np.array([width * c + height * s, width * s + height * c]) / ((c + s) * times_smaller)
        columns, rows = (int(n) for n in np.maximum(1, np.rint(size)))
        forth = Placement(_find_middle(columns, rows), self.turn_rad).warp(
            _find_middle(width, height), 1.0 / times_smaller
        )
        picture = source if times_smaller == 1 else cv2.blur(source, (times_smaller, times_smaller))
        turned = cv2.warpAffine(
            picture, forth, (columns, rows), flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
        )
        return np.asarray(turned, np.uint8), forth @ (*self.template.tip_px, 1.0)


@dataclass(frozen=True)
class _RefinedMatch:
    """The refined place of the template, and its correlation there."""

    place: Placement
    score: float


@dataclass(frozen=True, eq=False)
class _Match:
    """A candidate: the tip's pixel in the region, and the view that fits there."""

    view: _TurnedTemplate
    tip_px: _Point
    score: float


@dataclass(frozen=True, eq=False)
class _Region:
    """The part of a picture to search, its first pixel, and its masked pixels."""

    picture: Picture
    corner_px: tuple[int, int]
    masked: NDArray[np.bool_] | None

    @classmethod
    def around(
        cls,
        image: Picture,
        template: TipTemplate,
        near_px: _Point | None,
        side_px: float,
        mask: NDArray[np.bool_] | None,
    ) -> Self | None:
        """Return the square around a prediction, cut to the picture; None if nothing is left."""
        if near_px is None:
            return cls(image, (0, 0), mask)
        # The template may be larger on one side of its tip than on the other.
        side = max(side_px, float(max(template.picture.shape)))
        low = np.floor(np.asarray(near_px) - side / 2).astype(int)
        high = np.ceil(np.asarray(near_px) + side / 2).astype(int) + 1
        (left, top), (right, bottom) = np.maximum(low, 0), np.minimum(high, image.shape[::-1])
        if right - left < LEAST_SIDE_PX or bottom - top < LEAST_SIDE_PX:
            return None
        part = (slice(top, bottom), slice(left, right))
        return cls(image[part], (int(left), int(top)), None if mask is None else mask[part])

    def times_smaller(self, template: TipTemplate) -> int:
        most = _MOST_TIMES_SMALLER if self.picture.size > _SMALL_AREA_PX else 2
        return max(1, min(most, int(min(template.picture.shape)) // _LEAST_SMALL_SIDE_PX))

    def remove_glints(self, side_px: float) -> "_Region":
        return replace(self, picture=remove_glints(self.picture, side_px))

    def reduce(self, times: int) -> "_Region":
        if times == 1:
            return self
        rows, columns = (n // times * times for n in self.picture.shape)
        size = (columns // times, rows // times)
        picture = cv2.resize(self.picture[:rows, :columns], size, interpolation=cv2.INTER_AREA)
        masked = (
            None
            if self.masked is None
            else np.asarray(
                cv2.resize(
                    self.masked[:rows, :columns].astype(np.uint8) * 255, size, interpolation=cv2.INTER_AREA
                )
            )
            > 0
        )
        return _Region(np.asarray(picture, np.uint8), (0, 0), masked)

    def within(self, centre_px: _Point, reach_px: float) -> "_Region":
        """Return the part of this region within reach of a pixel; its corner is a pixel of this region."""
        left, top = (max(0, math.floor(at - reach_px)) for at in centre_px)
        right, bottom = (math.ceil(at + reach_px) + 1 for at in centre_px)
        part = (slice(top, bottom), slice(left, right))
        return _Region(self.picture[part], (left, top), None if self.masked is None else self.masked[part])


def _find_places(region: _Region, views: Sequence[_TurnedTemplate]) -> list[_Match]:
    """Return the most likely places, best first; places of the same side of the bevel are apart from one another."""
    template = views[0].template
    side_px, times = float(min(template.picture.shape)), region.times_smaller(template)
    small = region.reduce(times).remove_glints(side_px / times)
    rough = [
        replace(place, tip_px=_to_full_px(place.tip_px, times))
        for view in views
        for place in _find_peaks(small, view, times, _SAME_PLACE * side_px, _PLACES)
    ]
    near = _keep_best(rough)
    full = [_search_full_size(region, place, times) for place in near] if times > 1 else near
    return _keep_best([place for place in full if place is not None])


def _search_full_size(region: _Region, place: _Match, times_smaller: int) -> _Match | None:
    """Return the best place at full size around a place of the smaller picture."""
    reach_px = 0.75 * max(place.view.template.picture.shape) + 2.0 * times_smaller
    part = region.within(place.tip_px, reach_px).remove_glints(min(place.view.template.picture.shape))
    found = _find_peaks(part, place.view, 1, reach_px, 1)
    if not found:
        return None
    (u, v), (left, top) = found[0].tip_px, part.corner_px
    return replace(found[0], tip_px=(u + left, v + top))


def _find_peaks(
    region: _Region, view: _TurnedTemplate, times_smaller: int, apart_px: float, most: int
) -> list[_Match]:
    """Return the highest peaks of the correlation with a view, at least `apart_px` apart in the full picture."""
    patch, tip = view.patch(times_smaller)
    scores = _correlate(region, patch)
    if scores is None:
        return []
    reach = max(1, round(apart_px / times_smaller))
    places = []
    for _ in range(most):
        _, score, _, (u, v) = cv2.minMaxLoc(scores)
        if score <= 0.0:
            break
        places.append(_Match(view, (u + float(tip[0]), v + float(tip[1])), float(score)))
        scores[max(0, v - reach) : v + reach + 1, max(0, u - reach) : u + reach + 1] = -1.0
    return places


def _correlate(region: _Region, patch: Picture) -> NDArray[np.float32] | None:
    """Return the correlation for each place of the patch's first pixel; -1 if the window is flat or masked."""
    rows, columns = patch.shape
    if region.picture.shape[0] < rows or region.picture.shape[1] < columns:
        return None
    scores = np.asarray(cv2.matchTemplate(region.picture, patch, cv2.TM_CCOEFF_NORMED), np.float32)
    mean, square = (
        _average_windows(values, columns, rows)
        for values in (region.picture.astype(np.float32), np.square(region.picture, dtype=np.float32))
    )
    least = (_FLAT * float(cv2.meanStdDev(patch)[1][0, 0])) ** 2
    # A NaN fails the comparison, so it is not a tip either.
    usable = (square - mean * mean >= least) & (scores <= 1.01)
    if region.masked is not None:
        usable &= _average_windows(region.masked.astype(np.float32), columns, rows) <= 0.0
    scores[~usable] = -1.0
    return scores


def _average_windows(values: NDArray[np.float32], columns: int, rows: int) -> NDArray[np.float32]:
    """Return the mean of each window that lies in the picture, at its first pixel."""
    means = cv2.blur(values, (columns, rows), anchor=(0, 0))
    return np.asarray(means[: values.shape[0] - rows + 1, : values.shape[1] - columns + 1], np.float32)


def _refine(region: _Region, place: _Match) -> _RefinedMatch | None:
    """Refine pixel and heading of a place together; None if the fit diverges."""
    template = place.view.template
    part = region.within(place.tip_px, 0.75 * float(np.hypot(*template.picture.shape)) + 3.0)
    left, top = part.corner_px
    start = Placement((place.tip_px[0] - left, place.tip_px[1] - top), place.view.turn_rad)
    plain = part.remove_glints(float(min(template.picture.shape))).picture
    rough = template.coarse_fit.fit(plain, start)
    close = None if rough is None else template.close_fit.fit(part.picture, rough)
    if close is None:
        return None
    u, v = close.lands_px
    return _RefinedMatch(
        replace(close, lands_px=(u + left, v + top)), template.coarse_fit.score(plain, close)
    )


def _get_fitted_score(tried: tuple[_Match, _RefinedMatch | None]) -> float:
    return 0.0 if tried[1] is None else tried[1].score


def _judge(fit: _RefinedMatch | None, start: _Match, distinctness: float, *, predicted: bool) -> str | None:
    """Return why the refined place is not accepted as the tip, or None."""
    if fit is None:
        return "The template cannot be fitted to the best place."
    if fit.score < _LEAST_SCORE:
        return f"The score is {round_down(fit.score, 3)}, and {_LEAST_SCORE:g} is the least."
    if distinctness < _LEAST_DISTINCTNESS:
        return (
            f"The best place scores {round_down(distinctness, 3)} more than the next, "
            f"and {_LEAST_DISTINCTNESS:g} is the least: they cannot be told apart."
        )
    # A heading that was only tried may be far from the needle's; a predicted heading may not.
    turned_rad = abs(wrap_angle(fit.place.turn_rad - start.view.turn_rad)) if predicted else 0.0
    most_moved = _MOST_MOVED if predicted else 2.0 * _MOST_MOVED
    moved_px = math.dist(fit.place.lands_px, start.tip_px)
    if turned_rad > _MOST_TURNED_RAD or moved_px > most_moved * min(start.view.template.picture.shape):
        return (
            f"The fit went {moved_px:.1f} px and {math.degrees(turned_rad):.1f} degrees away from the best place, "
            "so it is not to be trusted."
        )
    return None


def _keep_best(places: Sequence[_Match]) -> list[_Match]:
    """Return the best places, each apart from every better place of the same side of the bevel."""
    kept: list[_Match] = []
    for place in sorted(places, key=lambda place: -place.score):
        if all(
            place.view.template is not better.view.template or _is_apart(place, better) for better in kept
        ):
            kept.append(place)
    return kept[:_PLACES]


def _is_apart(place: _Match, other: _Match) -> bool:
    """Return whether two places are too far apart to be the same tip."""
    reach_px = _SAME_PLACE * float(min(place.view.template.picture.shape))
    return math.dist(place.tip_px, other.tip_px) > reach_px


def _list_sides(template: TipTemplate, roll_rad: float | None) -> tuple[TipTemplate, ...]:
    if roll_rad is None:
        return (template, template.mirrored)
    return (template if template.has_same_side(roll_rad) else template.mirrored,)


def _to_full_px(px: _Point, times: int) -> _Point:
    """Return a pixel of the smaller picture in the full one; pixel centres are integers in both."""
    return (px[0] + 0.5) * times - 0.5, (px[1] + 0.5) * times - 0.5


def _find_middle(columns: int, rows: int) -> _Point:
    return (columns - 1) / 2, (rows - 1) / 2


def _check(
    grey: Picture,
    template: TipTemplate,
    mask: NDArray[np.bool_] | None,
    numbers: Sequence[float],
    region_px: float,
) -> None:
    (height, width), (rows, columns) = grey.shape, template.picture.shape
    if rows > height or columns > width:
        raise PictureError(
            f"the template has {columns} x {rows} pixels, larger than the picture, {width} x {height}",
            "use the camera setting that the template was made with",
        )
    if mask is not None and mask.shape != grey.shape:
        raise PictureError(
            f"the mask has shape {mask.shape}, the picture {grey.shape}", "use a mask made for this camera"
        )
    if not (np.isfinite(numbers).all() and math.isfinite(region_px) and region_px > 0.0):
        raise InputError(
            f"the prediction {tuple(numbers)} or the region of {region_px:g} px is not a number that can be used",
            "predict from a good frame",
        )
