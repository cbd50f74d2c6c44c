"""How far a needle's end is out of the plane, from the traces that depth leaves in a picture.

- Width: what is farther away looks thinner. Along the shaft the apparent width tells how x changes; its absolute value
  tells nothing, since edges look as wide as light and lens make them.
- Length: the arc length that is seen, against the length that was inserted. Where the needle runs away from the
  camera's foot, depth shortens it; a lean shortens it too, and so does slip, the share of the inserted length by which
  the tip lags behind. Slip is told by the lengths up to where the tip was seen on the way: the needle follows its tip,
  so they are lengths along the shaft.

Both are combined with what is known before, the covariance of the places along the needle. That may be wrong: a gel in
which needles wander more than it says, or a bevel that lags. So it holds with a probability only, and besides it the
needle may wander farther, by one of several amounts. The picture tells how likely each is (Bayes' theorem; Kass and
Raftery, "Bayes factors", 1995), and the end is where all together put it: a normal distribution of their variance would
leave out the tail of the farther ones. Where what is known before has become unlikely, the picture contradicts it, and
it counts for nothing.

Widths tell something in even light before a plain ground. In the 85 shared photographs of real needles, 6 to 7 px wide
before ruled paper, they scatter by 4 to 8 % and change by 10 % from end to end in a way that is not depth. Such widths
are left out.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labrig.vision.out_of_plane import Perspective, covary_walk
from labrig.vision.shaft_tip import ShaftTip

FloatArray = NDArray[np.float64]

# Length over which a width is the median of so many points, and what is left out at the sheath and, in diameters, at
# the bevel: smoothing along the shaft makes the last three millimetres look 1 to 4 % wider.
_BLOCK_MM, _FROM_MM, _BEVEL = 3.0, 4.0, 3.5
_LEAST_BLOCKS, _POINTS = 6, 30
# Scatter of these widths and what neighbours have in common, measured on 60 pictures of simulated needles of 12 px:
# 0.5 % of the width. _TAPER is that of a change of width along the whole needle that is not depth, such as light that
# differs from end to end. Widths that scatter by more than _MOST are left out.
_WIDTH_PX, _IN_COMMON, _TAPER, _MOST = 0.06, 0.4, 0.003, 0.015
# Standard deviation of the slip, of the ends' places, and of the needle's where the insertion begins [mm].
_SLIP, _ENDS_MM, _ZERO_MM = 0.01, 0.1, 0.3
# Of its change over 100 mm, as of a random walk, which was measured on no bench; and of the length up to a tip that was
# seen on the way [mm]. In 35 simulated insertions, whose slip does not change, depth is 0.15 mm off (rms), 0.4 told.
_SLIP_CHANGE, _SEEN_MM = 0.002, 0.06
# From where and how often such tips count, and how far beside the shaft they may lie: farther off something else was
# seen.
_WAY_FROM_MM, _WAY_STEP_MM, _ASIDE_MM = 8.0, 4.0, 0.5
# Probability that what is known before holds; and the standard deviations of the end if the needle wanders farther.
# Of 100 insertions each that wander four, six and ten times as much as told, 39, 57 and 73 end beyond 2 mm; none of
# these says success. Of 100 that wander as told all do (`wandering`).
_HOLDS, _FARTHER_MM = 0.5, (2.0, 5.0, 12.0, 30.0)
# With less probability what is known before is contradicted. Of 200 drawn pictures none alarmed where what is told is
# true; of 51 needles more than 3 mm out, where 0.05 deg/mm^0.5 were told, 40 did.
_CONTRADICTED = 0.045
_TINY_MM2, _TINY_MM = 1e-9, 1e-9
# Standard deviations of what traces have in common: a scale of all widths, their taper, the slip, and the place of a
# needle where the insertion begins, which a person sets by eye.
_COMMON_SDS = (1.0, _TAPER, _SLIP, _ZERO_MM)
# The steps end where none would move a place by this; most take 3 to 16.
_CONVERGED_MM, _MOST_STEPS = 1e-5, 200


@dataclass(frozen=True)
class PossibleDepth:
    """A normal distribution of the end's place out of the plane, and the probability that it holds."""

    probability: float
    x_mm: float
    sd_mm: float


@dataclass(frozen=True)
class Depth:
    """How far the end of a needle is out of the plane.

    Attributes
    ----------
    possible : tuple of PossibleDepth
        By all that is known, each with its probability.
    picture_x_mm, picture_sd_mm : float
        By the picture alone.
    contradicts : bool
        Whether picture and what was known before contradict each other; `possible` is then the picture's.
    """

    possible: tuple[PossibleDepth, ...]
    picture_x_mm: float
    picture_sd_mm: float
    contradicts: bool

    @property
    def x_mm(self) -> float:
        """The mean of all that is possible."""
        return _mix(self.possible)[0]

    @property
    def sd_mm(self) -> float:
        """The standard deviation of all that is possible."""
        return _mix(self.possible)[1]


def measure_depth(
    end: ShaftTip,
    perspective: Perspective,
    inserted_mm: float,
    at_mm: FloatArray,
    covariance_mm2: FloatArray,
    *,
    way_mm: FloatArray | None = None,
) -> Depth | None:
    """Return how far the end of a needle is out of the plane; None if its widths do not tell.

    Parameters
    ----------
    end : ShaftTip
    perspective : Perspective
    inserted_mm : float
        Length of the needle beyond the sheath.
    at_mm : ndarray (N,)
        Arc lengths from the sheath to the end, rising.
    covariance_mm2 : ndarray (N, N)
        Of the places out of the plane there, before the picture is looked at.
    way_mm : ndarray (K, 3) or None
        Inserted lengths, rising, and where (y, z) the tip was seen at them.
    """
    traces = _Traces.of(end, perspective, inserted_mm, at_mm, np.zeros((0, 3)) if way_mm is None else way_mm)
    if traces is None:
        return None
    before = covariance_mm2 + _TINY_MM2 * np.eye(len(at_mm))
    told = _update(traces, before, _Places(np.zeros(len(at_mm)), before))
    wandering = covary_walk(at_mm) * 3.0 / at_mm[-1] ** 3  # so that the end has a variance of 1
    farther = [_update(traces, before + far_mm**2 * wandering, told) for far_mm in _FARTHER_MM]
    each = (1.0 - _HOLDS) / len(farther)
    possible = _weigh((told, *farther), (_HOLDS, *(each for _ in farther)))
    alone = _weigh(farther, [each for _ in farther])
    contradicts = possible[0].probability < _CONTRADICTED
    return Depth(alone if contradicts else possible, *_mix(alone), contradicts)


def _find_lengths(end: ShaftTip, inserted_mm: float, way_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return inserted lengths (K,) and the lengths of shaft up to where the tip was seen at them, the end last."""
    kept, next_mm = list[int](), _WAY_FROM_MM
    for number, at_mm in enumerate(way_mm[:, 0]):
        if at_mm >= next_mm and at_mm < inserted_mm:
            kept.append(number)
            next_mm = at_mm + _WAY_STEP_MM
    apart_mm = way_mm[kept, None, 1:] - end.centre_line_mm
    near = np.argmin(np.sum(apart_mm**2, axis=2), axis=1)
    apart_mm = apart_mm[np.arange(len(near)), near]
    along_mm = np.sum(apart_mm * np.gradient(end.centre_line_mm, end.arc_mm, axis=0)[near], axis=1)
    on = np.sum(apart_mm**2, axis=1) - along_mm**2 <= _ASIDE_MM**2
    inserted, arcs_mm = way_mm[kept, 0][on], (end.arc_mm[near] + along_mm)[on]
    return np.append(inserted, inserted_mm), np.append(arcs_mm, end.length_mm)


@dataclass(frozen=True, eq=False)
class _Places:
    """Places out of the plane along the needle [mm], (N,), their covariance (N, N), and the traces' log-likelihood."""

    mean_mm: FloatArray
    covariance: FloatArray
    log_likelihood: float = 0.0


def _weigh(alternatives: Sequence[_Places], before: Sequence[float]) -> tuple[PossibleDepth, ...]:
    """Return the end by each alternative, by the probability before the picture and the likelihood of its traces."""
    logs = np.log(before) + [places.log_likelihood for places in alternatives]
    shares = np.exp(logs - logs.max())
    return tuple(
        PossibleDepth(float(share), float(places.mean_mm[-1]), float(places.covariance[-1, -1] ** 0.5))
        for share, places in zip(shares / shares.sum(), alternatives, strict=True)
    )


def _mix(possible: Sequence[PossibleDepth]) -> tuple[float, float]:
    """Return the mean and the standard deviation of all that is possible."""
    x_mm = sum(one.probability * one.x_mm for one in possible)
    return x_mm, math.sqrt(sum(one.probability * (one.sd_mm**2 + (one.x_mm - x_mm) ** 2) for one in possible))


@dataclass(frozen=True, eq=False)
class _Traces:
    """What is seen of depth: logarithms of M widths over their median, and K inserted lengths [mm], (M + K,).

    Attributes
    ----------
    covariance : ndarray (M + K, M + K)
        Of these.
    between : ndarray (M, N)
        How the depth where widths are measured follows from the places along the needle.
    common : ndarray (M + K, 4)
        What a scale of all widths, their taper, slip and the needle's place at the beginning add.
    nodes_mm : ndarray (N, 2)
        What is seen of the needle at its places, from the camera's foot.
    steps_mm : ndarray (N - 1,)
        Between its places.
    until : ndarray (K, N - 1)
        Which share of each step lies before each place up to which the length is seen.
    height_mm : float
        Of the camera.
    """

    seen: FloatArray
    covariance: FloatArray
    between: FloatArray
    common: FloatArray
    nodes_mm: FloatArray
    steps_mm: FloatArray
    until: FloatArray
    height_mm: float

    @classmethod
    def of(
        cls,
        end: ShaftTip,
        perspective: Perspective,
        inserted_mm: float,
        at_mm: FloatArray,
        way_mm: FloatArray,
    ) -> "_Traces | None":
        """Return the traces of a needle; None for too few widths, or if they scatter too much."""
        usual_mm = float(np.median(end.widths_mm))
        last_mm = end.length_mm - _BEVEL * usual_mm
        count = int((last_mm - _FROM_MM) / _BLOCK_MM)
        if count < _LEAST_BLOCKS:
            return None
        # Between rows and in blocks that fill the length, so that no row's rounding decides where it belongs.
        edges_mm = np.linspace(_FROM_MM, last_mm, count + 1)
        points_mm = np.linspace(_FROM_MM, last_mm, count * _POINTS + 1)[:-1].reshape(count, _POINTS)
        widths_mm = np.median(np.interp(points_mm, end.arc_mm, end.widths_mm), axis=1)
        stretch = at_mm[-1] / end.length_mm
        places_mm = 0.5 * (edges_mm[:-1] + edges_mm[1:]) * stretch
        logs = np.log(widths_mm / usual_mm)
        # The second differences of a smooth change are small: they show the scatter, less what neighbours have in
        # common.
        scatter = np.mean(np.diff(logs, 2) ** 2) / (6.0 - 8.0 * _IN_COMMON + 2.0 * _IN_COMMON**2)
        sd = max(math.sqrt(scatter), _WIDTH_PX / end.width_px)
        if sd > _MOST:
            return None
        nodes_mm = np.column_stack(
            [np.interp(at_mm, end.arc_mm * stretch, line) for line in end.centre_line_mm.T]
        )
        inserted, arcs_mm = _find_lengths(end, inserted_mm, way_mm)
        # Interpolated between nodes, and without its bevel, the needle looks shorter than it is.
        steps_mm = np.diff(at_mm)
        until = np.clip((arcs_mm[:, None] * stretch - at_mm[:-1]) / steps_mm, 0.0, 1.0)
        until[-1] = 1.0
        chords_mm = until @ np.linalg.norm(np.diff(nodes_mm, axis=0), axis=1)
        lengths = len(inserted)
        covariance = np.zeros((count + lengths, count + lengths))
        walked = _SLIP_CHANGE**2 / 100.0 * covary_walk(inserted)
        covariance[count:, count:] = walked + np.diag([*[_SEEN_MM**2] * (lengths - 1), _ENDS_MM**2])
        apart = np.abs(np.subtract.outer(places_mm, places_mm)) / _BLOCK_MM
        covariance[:count, :count] = sd**2 * _IN_COMMON**apart
        common = np.zeros((count + lengths, len(_COMMON_SDS)))
        common[:count, 0], common[:count, 1] = 1.0, places_mm / at_mm[-1] - 0.5
        common[count:, 2], common[count:, 3] = inserted, 1.0
        return cls(
            np.append(logs, inserted - arcs_mm + chords_mm),
            covariance,
            np.column_stack([np.interp(places_mm, at_mm, unit) for unit in np.eye(len(at_mm))]),
            common,
            nodes_mm - perspective.foot_mm,
            steps_mm,
            until,
            perspective.height_mm,
        )

    def linearise(self, places: _Places) -> tuple[FloatArray, FloatArray]:
        """Return what is expected (M + K,) of a needle at these places, uncertain as they are, and its slopes by N."""
        far = self.height_mm + self.between @ places.mean_mm
        grown = 1.0 + places.mean_mm / self.height_mm
        runs_mm, rises_mm = np.diff(grown[:, None] * self.nodes_mm, axis=0), np.diff(places.mean_mm)
        lengths_mm = np.maximum(np.hypot(np.linalg.norm(runs_mm, axis=1), rises_mm), _TINY_MM)
        variances = places.covariance.diagonal()
        spread = variances[1:] + variances[:-1] - 2.0 * places.covariance.diagonal(1)
        along, up = runs_mm / lengths_mm[:, None], rises_mm / lengths_mm
        steps = np.arange(len(lengths_mm))
        slopes = np.zeros((len(steps), len(grown)))
        slopes[steps, steps] = -np.sum(along * self.nodes_mm[:-1], axis=1) / self.height_mm - up
        slopes[steps, steps + 1] = np.sum(along * self.nodes_mm[1:], axis=1) / self.height_mm + up
        lengths_mm = lengths_mm + 0.5 * spread / self.steps_mm
        expected = np.append(np.log(self.height_mm / far), self.until @ lengths_mm)
        return expected, np.vstack((-self.between / far[:, None], self.until @ slopes))


def _update(traces: _Traces, before: FloatArray, near: _Places) -> _Places:
    """Return the places after the traces, by Gauss-Newton steps from places near by.

    A needle towards the camera's foot looks as long at two depths, since depth shortens what a lean lengthens. So the
    steps start at what is known.
    """
    count, places = len(before), near
    prior = np.diag([*np.zeros(count), *np.square(_COMMON_SDS)])
    prior[:count, :count] = before
    share, before_mm = 1.0, math.inf
    for _ in range(_MOST_STEPS):
        expected, slopes = traces.linearise(places)
        rows = np.hstack((slopes, traces.common))
        seen, shared = traces.seen - expected + slopes @ places.mean_mm, rows @ prior
        root = np.linalg.cholesky(shared @ rows.T + traces.covariance)
        whitened = np.linalg.solve(root, np.column_stack((shared[:, :count], seen)))
        gain, seen = whitened[:, :-1].T, whitened[:, -1]
        covariance = before - gain @ gain.T
        likelihood = -0.5 * float(seen @ seen) - float(np.log(root.diagonal()).sum())
        step_mm = gain @ seen - places.mean_mm
        largest_mm = float(np.abs(step_mm).max())
        # Steps that grow go back and forth about the place.
        share = 0.5 * share if largest_mm > before_mm else share
        before_mm = largest_mm
        places = _Places(places.mean_mm + share * step_mm, covariance, likelihood)
        if largest_mm < _CONVERGED_MM:
            break
    return places
