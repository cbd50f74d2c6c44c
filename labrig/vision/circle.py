"""The circle through points, by orthogonal distances.

There are two methods, chosen by name, which both start from the best of many circles through three points. "robust" is
an M-estimate with Tukey's biweight; use it for points measured in a picture. "geometric" minimises the sum of squared
orthogonal distances: the same, with the scale of the biweight infinite.
"""

from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import least_squares

from labrig.errors import InputError, MeasurementRefusedError

CircleMethod = Literal["robust", "geometric"]

_FloatArray = NDArray[np.float64]

# Least ratio of the points' two principal extents: below it the points are collinear to double precision.
_LEAST_FLATNESS = 1e-8
# Largest radius, in units of the points' rms distance from their centroid. So flat an arc has a sagitta of a
# millionth of its length, which no picture can show.
_LARGEST_RADIUS = 1e6
# Relative change at which the search ends.
_SETTLED = 1e-15
# Reweighted steps in which the scale follows the residuals.
_SCALE_STEPS = 10
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
        Points with a weight above zero: all points, unless the method is "robust".
    influences : ndarray (N,)
        The residuals as far as they move the fit: psi over the mean of psi' (Huber 1981, Robust Statistics, section
        7.6); the residuals themselves, unless the method is "robust". That of an outlier is zero.
    """

    centre: tuple[float, float]
    radius: float
    residual_rms: float
    inliers: NDArray[np.bool_]
    influences: _FloatArray

    def residuals(self, points: ArrayLike) -> _FloatArray:
        """Return the signed orthogonal distances of points (N, 2), positive outside the circle."""
        offsets = np.asarray(points, dtype=np.float64) - np.asarray(self.centre)
        return np.asarray(np.hypot(offsets[:, 0], offsets[:, 1]) - self.radius)


def _find_residuals(model: _FloatArray, points: _FloatArray) -> _FloatArray:
    """Return the signed distances (N,) of points from the circle (a, b, r), positive outside."""
    return np.asarray(np.hypot(points[:, 0] - model[0], points[:, 1] - model[1]) - model[2])


def _find_slopes(model: _FloatArray, points: _FloatArray) -> _FloatArray:
    """Return the Jacobian (N, 3) of the residuals; a point on the centre has no direction, and zeros in (a, b)."""
    offsets = points - model[:2]
    distances = np.maximum(np.hypot(offsets[:, 0], offsets[:, 1]), np.finfo(float).tiny)
    return np.column_stack((-offsets / distances[:, None], -np.ones(len(points))))


def fit_circle(points: ArrayLike, *, method: CircleMethod = "robust") -> Circle:
    """Fit a circle to points in the plane.

    Parameters
    ----------
    points : array_like (N, 2)
        N >= 3, any unit.
    method : "robust" or "geometric"
        "robust" tolerates outliers (fewer than half) and is for points measured in a picture. It is
        deterministic; the order of the points changes only rounding and the choice of its start.
        "geometric" is the least-squares answer, tested against certified values.

    Raises
    ------
    InputError
        If the array is not (N, 2) or the method is unknown.
    MeasurementRefusedError
        If there are fewer than three points, a point is not finite, or the points are collinear or coincide.
    """
    array = _check_points(points)
    if method not in get_args(CircleMethod):
        raise InputError(
            f"circle method {method!r} is unknown", f"one of {', '.join(get_args(CircleMethod))}"
        )
    centroid = array.mean(axis=0)
    scale = float(np.sqrt(np.mean(np.sum((array - centroid) ** 2, axis=1))))
    normal = (array - centroid) / scale
    start = _find_least_median(normal)
    model, weights = _fit_robustly(normal, start) if method == "robust" else _fit_squares(normal, start)
    if not model[2] < _LARGEST_RADIUS:
        raise _collinear_error(len(array))
    return _restore_units(model, normal, weights, centroid, scale)


def _check_points(points: ArrayLike) -> _FloatArray:
    array = np.asarray(points, dtype=np.float64)
    if array.ndim != 2 or array.shape[1] != 2:
        raise InputError(f"points for a circle have shape {array.shape}, not (N, 2)", "one row per point")
    if len(array) < 3:
        raise MeasurementRefusedError(
            f"{len(array)} points do not determine a circle", "at least 3 are needed"
        )
    if not np.isfinite(array).all():
        bad = int(np.flatnonzero(~np.isfinite(array).all(axis=1))[0])
        raise MeasurementRefusedError(f"point {bad} for the circle is {array[bad].tolist()}, not finite")
    extents = np.linalg.svd(array - array.mean(axis=0), compute_uv=False)
    if extents[1] <= _LEAST_FLATNESS * extents[0]:
        raise _collinear_error(len(array))
    return array


def _collinear_error(count: int) -> MeasurementRefusedError:
    return MeasurementRefusedError(
        f"{count} points for the circle lie on a straight line or in one place",
        "a longer or more curved arc is needed",
    )


def _find_least_median(points: _FloatArray) -> _FloatArray:
    """Return the circle through three of the points with the least median absolute residual."""
    generator = np.random.default_rng(_TRIPLE_SEED)
    triples = points[generator.integers(0, len(points), size=(_TRIPLES, 3))]
    centres, radii = _find_circumcircles(triples)
    judges = points[np.linspace(0, len(points) - 1, min(len(points), _POINTS_JUDGING_A_TRIPLE)).astype(int)]
    offsets = judges[None, :, :] - centres[:, None, :]
    residuals = np.abs(np.hypot(offsets[..., 0], offsets[..., 1]) - radii[:, None])
    medians = np.median(residuals, axis=1)
    if not len(medians) or not np.isfinite(medians).any():
        raise _collinear_error(len(points))
    best = int(np.nanargmin(medians))
    return np.append(centres[best], radii[best])


def _find_circumcircles(triples: _FloatArray) -> tuple[_FloatArray, _FloatArray]:
    """Return centres and radii of the circles through triples (K, 3, 2), leaving out collinear ones."""
    origin = triples[:, 0]
    p, q = triples[:, 1] - origin, triples[:, 2] - origin
    double_area = p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0]
    kept = np.abs(double_area) > _LEAST_FLATNESS
    origin, p, q, double_area = origin[kept], p[kept], q[kept], double_area[kept]
    pp, qq = np.sum(p * p, axis=1), np.sum(q * q, axis=1)
    offset = np.column_stack((q[:, 1] * pp - p[:, 1] * qq, p[:, 0] * qq - q[:, 0] * pp)) / (
        2.0 * double_area[:, None]
    )
    return origin + offset, np.hypot(offset[:, 0], offset[:, 1])


def _fit_squares(points: _FloatArray, start: _FloatArray) -> tuple[_FloatArray, _FloatArray]:
    """Return the circle of least squares, and weights (N,) of one.

    A search ends where the sum of squares changes no more, which leaves half of the digits; two steps find the others.
    """
    weights = np.ones(len(points))
    model = _search(points, start, "linear", 1.0)
    for _ in range(2):
        model = _step(points, model, weights)
    return model, weights


def _fit_robustly(points: _FloatArray, start: _FloatArray) -> tuple[_FloatArray, _FloatArray]:
    """Return the circle that minimises Tukey's biweight, and the weights (N,).

    The scale follows the residuals for the first, reweighted steps and is then held, so that a minimum exists.
    Reweighting alone converges slowly if many points are close to being outliers.
    """
    model, scale = start, 0.0
    for _ in range(_SCALE_STEPS):
        residuals = _find_residuals(model, points)
        scale = _robust_scale(residuals)
        model = _step(points, model, _biweight(residuals, scale))
    model = _search(points, model, _lose_by_tukey, _TUKEY_CONSTANT * scale)
    return model, _biweight(_find_residuals(model, points), scale)


def _step(points: _FloatArray, model: _FloatArray, weights: _FloatArray) -> _FloatArray:
    """Return the circle after a weighted Gauss-Newton step."""
    root = np.sqrt(weights)
    slopes, residuals = _find_slopes(model, points), _find_residuals(model, points)
    return np.asarray(model - np.linalg.lstsq(root[:, None] * slopes, root * residuals, rcond=None)[0])


def _search(points: _FloatArray, start: _FloatArray, loss: Any, scale: float) -> _FloatArray:
    """Return the circle of least loss near a start; raises MeasurementRefusedError if the search does not settle."""
    found = least_squares(
        _find_residuals,
        start,
        _find_slopes,
        args=(points,),
        loss=loss,
        f_scale=scale,
        x_scale="jac",
        ftol=_SETTLED,
        xtol=_SETTLED,
        gtol=_SETTLED,
    )
    if not found.success:
        raise MeasurementRefusedError(
            f"the robust circle through {len(points)} points does not settle: they lie on no single circle",
            "leave out what is not on the arc",
        )
    return np.asarray(found.x)


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


def _restore_units(
    model: _FloatArray, normal: _FloatArray, weights: _FloatArray, centroid: _FloatArray, scale: float
) -> Circle:
    inliers = weights > 0.0
    residuals = _find_residuals(model, normal)
    return Circle(
        centre=(float(centroid[0] + scale * model[0]), float(centroid[1] + scale * model[1])),
        radius=float(scale * model[2]),
        residual_rms=scale * float(np.sqrt(np.mean(residuals[inliers] ** 2))),
        inliers=inliers,
        influences=scale * weights * residuals / max(float(np.mean(_slopes(weights))), _LEAST_SLOPE),
    )


def _slopes(weights: _FloatArray) -> _FloatArray:
    """Return psi' (N,): psi = r (1 - q)^2 with q = (r / c)^2, so psi' = (1 - q)(1 - 5 q); unit weights have 1."""
    root = np.sqrt(weights)
    return np.asarray(root * (5.0 * root - 4.0))
