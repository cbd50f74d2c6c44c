"""The circle through points, by orthogonal distances.

The fit is an M-estimate with Tukey's biweight, from the best of many circles through three points. That of least
squares is the same with an infinite scale.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import least_squares

from labrig.errors import InputError, MeasurementRefusedError

_FloatArray = NDArray[np.float64]

# Least ratio of the points' two principal extents: below it the points are collinear to double precision.
_LEAST_FLATNESS = 1e-8
# Largest radius, in units of the points' rms distance from their centroid. So flat an arc has a sagitta of a
# millionth of its length, which no picture can show.
_LARGEST_RADIUS = 1e6
# Relative changes at which the search ends.
_SETTLED: dict[str, Any] = {"ftol": 1e-15, "xtol": 1e-15, "gtol": 1e-15}
# Reweighted steps in which the scale follows the residuals, most of those with a held scale, and those after a search.
_SCALE_STEPS, _MOST_STEPS, _LAST_STEPS = 10, 24, 6
# A step that moves the circle by less, in units of the points' rms distance from their centroid, is the last.
_SETTLED_STEP = 1e-12
_TRIPLES = 128
_POINTS_JUDGING_A_TRIPLE = 128
_TRIPLE_SEED = 20_090_816
# 95 % efficiency on normal residuals (Maronna et al. 2019, Robust Statistics, table 2.4).
_TUKEY_CONSTANT = 4.685
_MAD_TO_SIGMA = 1.4826
# Below this mean of psi' the points lie on no single circle, and the influences are as large as this allows.
_LEAST_SLOPE = 1e-3
# Scale below which residuals are rounding errors, in units of the points' rms distance from their centroid.
_ROUNDING = 1e-12


@dataclass(frozen=True, eq=False)
class Circle:
    """A fitted circle, in the unit of the points.

    Attributes
    ----------
    centre : (float, float)
        In the order of the points' columns.
    radius : float
        Positive.
    residual_rms : float
        Root mean square of the orthogonal distances of the inliers.
    inliers : ndarray of bool (N,)
        Points with a weight above zero: all points of a fit by least squares.
    influences : ndarray (N,)
        The residuals as far as they move the fit: psi over the mean of psi' (Huber 1981, Robust Statistics, section
        7.6). That of an outlier is zero.
    """

    centre: tuple[float, float]
    radius: float
    residual_rms: float
    inliers: NDArray[np.bool_]
    influences: _FloatArray

    def residuals(self, points: ArrayLike) -> _FloatArray:
        """Return the signed orthogonal distances of points (N, 2), positive outside the circle."""
        return _find_residuals(np.array([*self.centre, self.radius]), np.asarray(points, dtype=np.float64))


def _find_residuals(model: _FloatArray, points: _FloatArray) -> _FloatArray:
    """Return the signed distances (N,) of points from the circle (a, b, r), positive outside."""
    return np.asarray(np.hypot(points[:, 0] - model[0], points[:, 1] - model[1]) - model[2])


def _find_slopes(model: _FloatArray, points: _FloatArray) -> _FloatArray:
    """Return the Jacobian (N, 3) of the residuals; a point on the centre has no direction, and zeros in (a, b)."""
    offsets = points - model[:2]
    distances = np.maximum(np.hypot(*offsets.T), np.finfo(float).tiny)
    return np.column_stack((-offsets / distances[:, None], -np.ones(len(points))))


def fit_circle(points: ArrayLike, *, robust: bool = True) -> Circle:
    """Fit a circle to points in the plane.

    Parameters
    ----------
    points : array_like (N, 2)
        N >= 3, any unit.
    robust : bool
        Tolerate outliers (fewer than half), as among points measured in a picture. The order of the points changes only
        rounding and the choice of the start. Otherwise the answer of least squares, tested against certified values.

    Raises
    ------
    InputError
        If the array is not (N, 2).
    MeasurementRefusedError
        If there are fewer than three points, a point is not finite, or the points are collinear or coincide.
    """
    array = _check_points(points)
    centroid = array.mean(axis=0)
    extents = np.linalg.svd(array - centroid, compute_uv=False)
    if extents[1] <= _LEAST_FLATNESS * extents[0]:
        raise _collinear_error(len(array))
    unit = float(np.sqrt(np.mean(np.sum((array - centroid) ** 2, axis=1))))
    normal = (array - centroid) / unit
    model = _find_least_median(normal)
    scale = np.inf
    # The scale follows the residuals and is then held, so that a minimum exists.
    for _ in range(_SCALE_STEPS if robust else 0):
        scale = _robust_scale(_find_residuals(model, normal))
        model = _step(normal, model, scale)
    model = _settle(normal, model, scale)
    if not model[2] < _LARGEST_RADIUS:
        raise _collinear_error(len(array))
    residuals = _find_residuals(model, normal)
    weights = _biweight(residuals, scale)
    root, inliers = np.sqrt(weights), weights > 0.0
    # psi = r (1 - q)^2 with q = (r / c)^2, so psi' = (1 - q)(1 - 5 q).
    slope = float(np.mean(root * (5.0 * root - 4.0)))
    centre = centroid + unit * model[:2]
    return Circle(
        centre=(float(centre[0]), float(centre[1])),
        radius=float(unit * model[2]),
        residual_rms=unit * float(np.sqrt(np.mean(residuals[inliers] ** 2))),
        inliers=inliers,
        influences=unit * weights * residuals / max(slope, _LEAST_SLOPE),
    )


def _check_points(points: ArrayLike) -> _FloatArray:
    array = np.asarray(points, dtype=np.float64)
    if array.ndim != 2 or array.shape[1] != 2:
        raise InputError(f"points for a circle have shape {array.shape}, not (N, 2)", "one row per point")
    if len(array) < 3:
        raise MeasurementRefusedError(
            f"{len(array)} points do not determine a circle", "at least 3 are needed"
        )
    if not np.isfinite(array).all():
        raise MeasurementRefusedError("a point for the circle is not finite")
    return array


def _collinear_error(count: int) -> MeasurementRefusedError:
    return MeasurementRefusedError(
        f"{count} points for the circle lie on a straight line or in one place",
        "a longer or more curved arc is needed",
    )


def _find_least_median(points: _FloatArray) -> _FloatArray:
    """Return the circle through three of the points with the least median absolute residual."""
    triples = points[np.random.default_rng(_TRIPLE_SEED).integers(0, len(points), size=(_TRIPLES, 3))]
    origins, sides = triples[:, 0], triples[:, 1:] - triples[:, :1]
    kept = np.abs(np.linalg.det(sides)) > _LEAST_FLATNESS
    if not kept.any():
        raise _collinear_error(len(points))
    halves = 0.5 * np.sum(sides[kept] ** 2, axis=2, keepdims=True)
    offsets = np.linalg.solve(sides[kept], halves)[..., 0]
    models = np.column_stack((origins[kept] + offsets, np.hypot(*offsets.T)))
    judges = points[np.linspace(0, len(points) - 1, min(len(points), _POINTS_JUDGING_A_TRIPLE)).astype(int)]
    away = np.linalg.norm(judges[None] - models[:, None, :2], axis=2) - models[:, 2:]
    return np.asarray(models[int(np.argmin(np.median(np.abs(away), axis=1)))])


def _step(points: _FloatArray, model: _FloatArray, scale: float) -> _FloatArray:
    """Return the circle after a Gauss-Newton step with the weights of the biweight."""
    residuals = _find_residuals(model, points)
    root = np.sqrt(_biweight(residuals, scale))
    slopes = root[:, None] * _find_slopes(model, points)
    return np.asarray(model - np.linalg.lstsq(slopes, root * residuals, rcond=None)[0])


def _settle(points: _FloatArray, model: _FloatArray, scale: float) -> _FloatArray:
    """Return the circle where no step moves it; steps alone are slow where many points are nearly outliers.

    There a search follows. It ends where the loss changes no more, which leaves half of the digits; further steps find
    the others.
    """
    for _ in range(_MOST_STEPS):
        before, model = model, _step(points, model, scale)
        if np.abs(model - before).max() <= _SETTLED_STEP:
            return model
    robust = np.isfinite(scale)
    loss: Any = _lose_by_tukey if robust else "linear"
    found = least_squares(
        _find_residuals,
        model,
        _find_slopes,
        args=(points,),
        loss=loss,
        f_scale=_TUKEY_CONSTANT * scale if robust else 1.0,
        x_scale="jac",
        **_SETTLED,
    )
    if not found.success:
        raise MeasurementRefusedError(
            f"the robust circle through {len(points)} points does not settle: they lie on no single circle",
            "leave out what is not on the arc",
        )
    model = found.x
    for _ in range(_LAST_STEPS):
        model = _step(points, model, scale)
    return model


def _lose_by_tukey(squares: _FloatArray) -> _FloatArray:
    """Return Tukey's loss of squared residuals over the squared constant, with its first two derivatives, (3, N)."""
    left = np.maximum(1.0 - squares, 0.0)
    return np.array(((1.0 - left**3) / 3.0, left**2, -2.0 * left))


def _robust_scale(residuals: _FloatArray) -> float:
    """Return the standard deviation of the inliers, corrected for few points (Rousseeuw 1987, p. 202)."""
    correction = _MAD_TO_SIGMA * (1.0 + 5.0 / max(len(residuals) - 3, 1))
    return max(correction * float(np.median(np.abs(residuals))), _ROUNDING)


def _biweight(residuals: _FloatArray, scale: float) -> _FloatArray:
    ratio = np.minimum(np.abs(residuals) / (_TUKEY_CONSTANT * scale), 1.0)
    return np.asarray((1.0 - ratio * ratio) ** 2)
