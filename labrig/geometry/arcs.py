"""A path of several circular arcs through points in order, each going on where and as the one before it ends.

A needle whose bevel was turned over bends the other way from there on: its heading goes on, its curvature jumps. So the
path is a start, a heading, a curvature for each arc and the arc lengths at which it changes, fitted together by least
squares of the orthogonal distances. An arc more is taken only when it explains far more than chance would, counting as
many independent points as the residuals' correlation leaves.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import OptimizeResult, least_squares

from labrig.errors import InputError, MeasurementRefusedError

_FloatArray = NDArray[np.float64]

_LEAST_POINTS = 12
# Places of a new break that are tried, as shares of the path.
_TRIED_BREAKS = np.linspace(0.1, 0.9, 9)
# F-ratio above which a further arc is taken: far beyond chance, since its place was searched for.
_LEAST_RATIO = 12.0
# Of a path's parameters: how far aside of its first point it starts, and the heading there.
_POSE = 2
# Points whose median stands for the path where its length is measured: noise would add to that.
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
        Signed, positive where the path turns from its second axis towards its first, with a standard deviation that
        counts the residuals' correlation.
    length : float
    start, end : (float, float)
    """

    curvature: float
    sigma_curvature: float
    length: float
    start: tuple[float, float]
    end: tuple[float, float]

    @property
    def radius(self) -> float:
        """Return the radius; infinite for a straight one."""
        return 1.0 / abs(self.curvature) if self.curvature else float("inf")


@dataclass(frozen=True)
class ArcPath:
    """Arcs in order; a flip point is where one ends and the next begins.

    Attributes
    ----------
    arcs : tuple of Arc
    residual_rms : float
    """

    arcs: tuple[Arc, ...]
    residual_rms: float

    @property
    def flips(self) -> tuple[tuple[float, float], ...]:
        """Return the points at which the curvature changes."""
        return tuple(arc.start for arc in self.arcs[1:])


@dataclass(frozen=True, eq=False)
class _Line:
    """Points (N, 2), their arc lengths (N,) from zero, and a place near the first of them (2,)."""

    points: _FloatArray
    along: _FloatArray
    start: _FloatArray
    least_length: float

    def off(self, parameters: _FloatArray) -> _FloatArray:
        """Return the signed distances (N,) of the points from the path."""
        places, headings = _path(self.start, parameters, self.along)
        aside = self.points - places
        return np.asarray(aside[:, 0] * np.cos(headings) - aside[:, 1] * np.sin(headings))


def fit_arcs(points: ArrayLike, *, most: int = 3, least_length: float = 5.0) -> ArcPath:
    """Fit a path of as many arcs as the points speak for.

    Parameters
    ----------
    points : array_like (N, 2)
        In order along the path, columns (y, z); a heading is zero along z, positive towards y.
    most : int
        Arcs that are tried.
    least_length : float
        Of an arc, in the unit of the points.

    Raises
    ------
    InputError
        If the array is not (N, 2), or no arc is asked for.
    MeasurementRefusedError
        If there are too few points, or the path is shorter than an arc.
    """
    line = _checked(points, least_length)
    if most < 1:
        raise InputError(f"{most} arcs were asked for", "ask for 1 or more")
    fits = [_single(line)]
    while len(fits) < most:
        further = _with_another(line, fits[-1])
        if further is None:
            break
        fits.append(further)
    return _described(line, _simplest(line, fits))


def _checked(points: ArrayLike, least_length: float) -> _Line:
    array = np.asarray(points, dtype=np.float64)
    if array.ndim != 2 or array.shape[1] != 2:
        raise InputError(f"points for arcs have shape {array.shape}, not (N, 2)", "one row a point")
    if len(array) < _LEAST_POINTS or not np.isfinite(array).all():
        raise MeasurementRefusedError(
            f"{len(array)} points do not determine arcs, or one is not finite",
            f"at least {_LEAST_POINTS} are needed",
        )
    smooth, along = _lengths(array)
    if along[-1] < least_length:
        raise MeasurementRefusedError(
            f"the path is {along[-1]:.2f} long, and an arc has to be {least_length:g}", "insert further"
        )
    return _Line(array, along, smooth[0], least_length)


def _lengths(points: _FloatArray) -> tuple[_FloatArray, _FloatArray]:
    """Return smoothed points (N, 2) and the arc lengths (N,) at them, from zero."""
    half = max(1, round(len(points) * _SMOOTHED_SHARE / 2.0))
    padded = np.concatenate(
        (np.repeat(points[:1], half, axis=0), points, np.repeat(points[-1:], half, axis=0))
    )
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * half + 1, axis=0)
    medians = np.median(windows, axis=2)
    knots = np.unique(np.append(np.arange(0, len(points), 2 * half), len(points) - 1))
    lengths = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(medians[knots], axis=0).T))))
    return medians, np.interp(np.arange(len(points)), knots, lengths)


def _path(
    origin: _FloatArray, parameters: _FloatArray, along: _FloatArray
) -> tuple[_FloatArray, _FloatArray]:
    """Return points (N, 2) and headings (N,) at arc lengths (N,).

    Parameters are the distance aside of `origin`, the heading, the curvatures and the breaks: how far along the path it
    starts means nothing, and would be free.
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
    # sinc keeps the straight line in the same formula.
    return np.asarray(run * np.sinc(half / np.pi) * np.exp(1j * (heading + half)))


def _single(line: _Line) -> OptimizeResult:
    first, last = line.points[0], line.points[-1]
    heading = float(np.arctan2(last[0] - first[0], last[1] - first[1]))
    start = np.array([0.0, heading, 0.0])
    return _solved(line, start)


def _solved(line: _Line, start: _FloatArray) -> OptimizeResult:
    """Return the best path near `start`: first with its breaks held, then with all free and outliers down-weighted."""
    free = _POSE + (len(start) - _POSE + 1) // 2
    breaks = start[free:]

    def off_with_breaks_held(some: _FloatArray) -> _FloatArray:
        return line.off(np.concatenate((some, breaks)))

    held = least_squares(off_with_breaks_held, start[:free], loss="soft_l1")
    found = np.concatenate((held.x, breaks))
    for _ in range(_SCALE_STEPS):
        scale = max(_MAD_TO_SIGMA * float(np.median(np.abs(line.off(found)))), _LEAST_SCALE * line.along[-1])
        solved = least_squares(line.off, found, loss="soft_l1", f_scale=_FULL * scale, x_scale="jac")
        found = np.asarray(solved.x)
    return solved


def _with_another(line: _Line, best: OptimizeResult) -> OptimizeResult | None:
    """Return the best path of one arc more."""
    found: OptimizeResult | None = None
    arcs = (len(best.x) - _POSE + 1) // 2
    curvatures, breaks = best.x[_POSE : _POSE + arcs], best.x[_POSE + arcs :]
    for share in _TRIED_BREAKS:
        place = share * line.along[-1]
        index = int(np.searchsorted(breaks, place))
        start = np.concatenate(
            (best.x[:_POSE], np.insert(curvatures, index, curvatures[index]), np.insert(breaks, index, place))
        )
        if not _long_enough(line, start):
            continue
        tried = _solved(line, start)
        if _long_enough(line, tried.x) and (found is None or tried.cost < found.cost):
            found = tried
    return found


def _long_enough(line: _Line, parameters: _FloatArray) -> bool:
    arcs = (len(parameters) - _POSE + 1) // 2
    ends = np.concatenate(([0.0], parameters[_POSE + arcs :], line.along[-1:]))
    return bool((np.diff(ends) >= line.least_length).all())


def _simplest(line: _Line, fits: list[OptimizeResult]) -> OptimizeResult:
    """Return the path with the fewest arcs than which none explains far more than chance would.

    The noise and how many residuals count as one are taken from the richest path: where an arc is missing, what is left
    is no noise.
    """
    richest = fits[-1]
    squares = [float(np.sum(_clipped(one.fun) ** 2)) for one in fits]
    freedom = max(len(line.points) / _correlation(richest.fun) - len(richest.x), 1.0)
    for number, one in enumerate(fits):
        gains = (squares[number] - np.array(squares[number + 1 :])) / (2.0 * np.arange(1, len(fits) - number))
        if not (gains > _LEAST_RATIO * squares[-1] / freedom).any():
            return one
    return richest


def _clipped(residuals: _FloatArray) -> _FloatArray:
    """Return the residuals with outliers brought in."""
    reach = 2.0 * _FULL * _MAD_TO_SIGMA * float(np.median(np.abs(residuals)))
    return np.clip(residuals, -reach, reach)


def _correlation(residuals: _FloatArray) -> float:
    """Return how many neighbouring residuals count as one: the sum of their correlations, while it is positive."""
    centred = _clipped(residuals) - _clipped(residuals).mean()
    spectrum = np.abs(np.fft.rfft(centred, 2 * len(centred))) ** 2
    correlations = np.fft.irfft(spectrum)[: len(centred) // 3]
    if not correlations[0] > 0.0:
        return 1.0
    correlations = correlations / correlations[0]
    negative = np.flatnonzero(correlations < 0.0)
    until = int(negative[0]) if len(negative) else len(correlations)
    return float(max(1.0, 2.0 * correlations[:until].sum() - 1.0))


def _described(line: _Line, found: OptimizeResult) -> ArcPath:
    arcs = (len(found.x) - _POSE + 1) // 2
    ends = np.concatenate(([0.0], found.x[_POSE + arcs :], line.along[-1:]))
    places, _ = _path(line.start, np.asarray(found.x), ends)
    residuals = _clipped(found.fun)
    variance = float(residuals @ residuals) / max(len(residuals) - len(found.x), 1)
    covariance = np.linalg.pinv(found.jac.T @ found.jac) * variance * _correlation(found.fun)
    sigma = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    described = tuple(
        Arc(
            curvature=float(found.x[_POSE + index]),
            sigma_curvature=float(sigma[_POSE + index]),
            length=float(ends[index + 1] - ends[index]),
            start=(float(places[index, 0]), float(places[index, 1])),
            end=(float(places[index + 1, 0]), float(places[index + 1, 1])),
        )
        for index in range(arcs)
    )
    return ArcPath(described, float(np.sqrt(np.mean(residuals**2))))
