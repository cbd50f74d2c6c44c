"""A path of circular arcs through points in order; each arc continues the position and heading of the previous arc.

A needle whose bevel was turned over bends the other way from there on: its heading is continuous, its curvature jumps.
So a path is a start, a heading, a curvature for each arc, and the arc lengths at which the curvature changes. All are
fitted together by least squares of the orthogonal distances. A further arc is accepted only if it explains far more
than chance would. That test counts as many independent points as the correlation of the residuals leaves.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import OptimizeResult, least_squares

from labrig.errors import InputError, MeasurementRefusedError

_FloatArray = NDArray[np.float64]

_LEAST_POINTS = 12
# Where a new break is tried, as shares of the path.
_TRIED_BREAKS = np.linspace(0.1, 0.9, 9)
# F-ratio above which a further arc is accepted: far beyond chance, because the search chose the place of its break.
_LEAST_RATIO = 12.0
# The first parameters of a path: the sideways distance of its start from the first point, and the heading there.
_POSE = 2
# Share of the points in the running median on which the length is measured: noise would lengthen the path.
_SMOOTHED_SHARE = 1.0 / 40.0
_FULL = 3.0
_SCALE_STEPS = 2
_LEAST_SCALE = 1e-9
_MAD_TO_SIGMA = 1.4826


@dataclass(frozen=True)
class Arc:
    """One arc of a path.

    Attributes
    ----------
    curvature, sigma_curvature : float
        Signed: positive if the heading grows along the arc. The standard deviation allows for correlated residuals.
    length : float
    start : (float, float)
        Where the arc begins; for all but the first arc this is a flip point.
    """

    curvature: float
    sigma_curvature: float
    length: float
    start: tuple[float, float]

    @property
    def radius(self) -> float:
        """Return the radius; infinite for a straight line."""
        return 1.0 / abs(self.curvature) if self.curvature else float("inf")


@dataclass(frozen=True, eq=False)
class _Line:
    """Points (N, 2), their arc lengths (N,) from zero, and a place near the first point (2,)."""

    points: _FloatArray
    along: _FloatArray
    start: _FloatArray
    least_length: float

    def distances(self, parameters: _FloatArray) -> _FloatArray:
        """Return the signed distances (N,) of the points from the path."""
        places, headings = _trace_path(self.start, parameters, self.along)
        aside = self.points - places
        return np.asarray(aside[:, 0] * np.cos(headings) - aside[:, 1] * np.sin(headings))


def fit_arcs(points: ArrayLike, *, most: int = 3, least_length: float = 5.0) -> tuple[Arc, ...]:
    """Fit a path of as many arcs as the points justify, in order along the path.

    Parameters
    ----------
    points : array_like (N, 2)
        In order along the path, columns (y, z).
    most : int
        Largest number of arcs.
    least_length : float
        Shortest arc, in the unit of the points.

    Raises
    ------
    InputError
        If the array is not (N, 2), or `most` is below 1.
    MeasurementRefusedError
        If there are too few points, or the path is shorter than one arc may be.
    """
    line = _check_points(points, least_length)
    if most < 1:
        raise InputError(f"{most} arcs were asked for", "ask for 1 or more")
    fits = [_fit_single_arc(line)]
    while len(fits) < most:
        further = _add_arc(line, fits[-1])
        if further is None:
            break
        fits.append(further)
    return _describe_arcs(line, _choose_simplest(line, fits))


def _check_points(points: ArrayLike, least_length: float) -> _Line:
    array = np.asarray(points, dtype=np.float64)
    if array.ndim != 2 or array.shape[1] != 2:
        raise InputError(f"points for arcs have shape {array.shape}, not (N, 2)", "one row per point")
    if len(array) < _LEAST_POINTS or not np.isfinite(array).all():
        raise MeasurementRefusedError(
            f"{len(array)} points do not determine arcs, or a point is not finite",
            f"at least {_LEAST_POINTS} are needed",
        )
    smooth, along = _measure_lengths(array)
    if along[-1] < least_length:
        raise MeasurementRefusedError(
            f"the path is {along[-1]:.2f} long, and an arc must be at least {least_length:g} long",
            "insert further",
        )
    return _Line(array, along, smooth[0], least_length)


def _measure_lengths(points: _FloatArray) -> tuple[_FloatArray, _FloatArray]:
    """Return smoothed points (N, 2) and their arc lengths (N,), from zero."""
    half = max(1, round(len(points) * _SMOOTHED_SHARE / 2.0))
    padded = np.concatenate(
        (np.repeat(points[:1], half, axis=0), points, np.repeat(points[-1:], half, axis=0))
    )
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * half + 1, axis=0)
    medians = np.median(windows, axis=2)
    knots = np.unique(np.append(np.arange(0, len(points), 2 * half), len(points) - 1))
    lengths = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(medians[knots], axis=0).T))))
    return medians, np.interp(np.arange(len(points)), knots, lengths)


def _trace_path(
    origin: _FloatArray, parameters: _FloatArray, along: _FloatArray
) -> tuple[_FloatArray, _FloatArray]:
    """Return points (N, 2) and headings (N,) at arc lengths (N,).

    The parameters are the sideways distance from `origin`, the heading, the curvatures and the breaks. A shift of the
    start along the path is not a parameter: the points would not determine it.
    """
    arcs = (len(parameters) - _POSE + 1) // 2
    curvatures, breaks = parameters[_POSE : _POSE + arcs], parameters[_POSE + arcs :]
    heading = float(parameters[1])
    place = complex(origin[1], origin[0]) + float(parameters[0]) * 1j * np.exp(1j * heading)
    starts = np.concatenate(([0.0], breaks))
    places, headings = np.empty(len(along), complex), np.empty(len(along))
    which = np.clip(np.searchsorted(starts, along, side="right") - 1, 0, arcs - 1)
    for index in range(arcs):
        inside = which == index
        run = along[inside] - starts[index]
        places[inside] = place + _chord(curvatures[index], run, heading)
        headings[inside] = heading + curvatures[index] * run
        if index + 1 < arcs:
            length = starts[index + 1] - starts[index]
            place += complex(_chord(curvatures[index], np.array([length]), heading)[0])
            heading += float(curvatures[index] * length)
    return np.column_stack((places.imag, places.real)), headings


def _chord(curvature: float, run: _FloatArray, heading: float) -> NDArray[np.complex128]:
    """Return the vectors z + iy from an arc's start to the places at arc lengths `run`."""
    half = 0.5 * curvature * run
    # With sinc the same formula covers a straight line.
    return np.asarray(run * np.sinc(half / np.pi) * np.exp(1j * (heading + half)))


def _fit_single_arc(line: _Line) -> OptimizeResult:
    first, last = line.points[0], line.points[-1]
    heading = float(np.arctan2(last[0] - first[0], last[1] - first[1]))
    return _fit_near(line, np.array([0.0, heading, 0.0]))


def _fit_near(line: _Line, start: _FloatArray) -> OptimizeResult:
    """Fit the best path near `start`: first with the breaks held, then all parameters, with outliers down-weighted."""
    free = _POSE + (len(start) - _POSE + 1) // 2
    breaks = start[free:]

    def distances_with_breaks_held(parameters: _FloatArray) -> _FloatArray:
        return line.distances(np.concatenate((parameters, breaks)))

    held = least_squares(distances_with_breaks_held, start[:free], loss="soft_l1")
    found = np.concatenate((held.x, breaks))
    for _ in range(_SCALE_STEPS):
        typical = _MAD_TO_SIGMA * float(np.median(np.abs(line.distances(found))))
        scale = max(typical, _LEAST_SCALE * line.along[-1])
        solved = least_squares(line.distances, found, loss="soft_l1", f_scale=_FULL * scale, x_scale="jac")
        found = np.asarray(solved.x)
    return solved


def _add_arc(line: _Line, best: OptimizeResult) -> OptimizeResult | None:
    """Fit the best path with one more arc; None if its arcs would be too short."""
    found: OptimizeResult | None = None
    arcs = (len(best.x) - _POSE + 1) // 2
    curvatures, breaks = best.x[_POSE : _POSE + arcs], best.x[_POSE + arcs :]
    for share in _TRIED_BREAKS:
        place = share * line.along[-1]
        index = int(np.searchsorted(breaks, place))
        start = np.concatenate(
            (best.x[:_POSE], np.insert(curvatures, index, curvatures[index]), np.insert(breaks, index, place))
        )
        if not _has_long_arcs(line, start):
            continue
        tried = _fit_near(line, start)
        if _has_long_arcs(line, tried.x) and (found is None or tried.cost < found.cost):
            found = tried
    return found


def _has_long_arcs(line: _Line, parameters: _FloatArray) -> bool:
    arcs = (len(parameters) - _POSE + 1) // 2
    ends = np.concatenate(([0.0], parameters[_POSE + arcs :], line.along[-1:]))
    return bool((np.diff(ends) >= line.least_length).all())


def _choose_simplest(line: _Line, fits: list[OptimizeResult]) -> OptimizeResult:
    """Return the path with the fewest arcs over which no richer path gains far more than chance would.

    The noise and the correlation of the residuals come from the richest path: if an arc is missing, the residuals are
    not noise.
    """
    richest = fits[-1]
    squares = [float(np.sum(_clip_outliers(fit.fun) ** 2)) for fit in fits]
    freedom = max(len(line.points) / _correlation_length(richest.fun) - len(richest.x), 1.0)
    for number, fit in enumerate(fits):
        gains = (squares[number] - np.array(squares[number + 1 :])) / (2.0 * np.arange(1, len(fits) - number))
        if not (gains > _LEAST_RATIO * squares[-1] / freedom).any():
            return fit
    return richest


def _clip_outliers(residuals: _FloatArray) -> _FloatArray:
    reach = 2.0 * _FULL * _MAD_TO_SIGMA * float(np.median(np.abs(residuals)))
    return np.clip(residuals, -reach, reach)


def _correlation_length(residuals: _FloatArray) -> float:
    """Return how many neighbouring residuals count as one: the sum of their correlations up to the first negative."""
    centred = _clip_outliers(residuals) - _clip_outliers(residuals).mean()
    spectrum = np.abs(np.fft.rfft(centred, 2 * len(centred))) ** 2
    correlations = np.fft.irfft(spectrum)[: len(centred) // 3]
    if not correlations[0] > 0.0:
        return 1.0
    correlations = correlations / correlations[0]
    negative = np.flatnonzero(correlations < 0.0)
    until = int(negative[0]) if len(negative) else len(correlations)
    return float(max(1.0, 2.0 * correlations[:until].sum() - 1.0))


def _describe_arcs(line: _Line, found: OptimizeResult) -> tuple[Arc, ...]:
    arcs = (len(found.x) - _POSE + 1) // 2
    ends = np.concatenate(([0.0], found.x[_POSE + arcs :], line.along[-1:]))
    places, _ = _trace_path(line.start, np.asarray(found.x), ends)
    residuals = _clip_outliers(found.fun)
    variance = float(residuals @ residuals) / max(len(residuals) - len(found.x), 1)
    covariance = np.linalg.pinv(found.jac.T @ found.jac) * variance * _correlation_length(found.fun)
    sigma = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    return tuple(
        Arc(
            curvature=float(found.x[_POSE + index]),
            sigma_curvature=float(sigma[_POSE + index]),
            length=float(ends[index + 1] - ends[index]),
            start=(float(places[index, 0]), float(places[index, 1])),
        )
        for index in range(arcs)
    )
