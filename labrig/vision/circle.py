"""The circle through points, by orthogonal distances.

There are two methods, chosen by name, which both start from the best of many circles through three points. "robust" is
an M-estimate with Tukey's biweight; use it for points measured in a picture. "geometric" minimises the sum of squared
orthogonal distances: the same, with the scale of the biweight infinite.
"""

from dataclasses import dataclass
from typing import Literal, NamedTuple, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from labrig.errors import InputError, MeasurementRefusedError

CircleMethod = Literal["robust", "geometric"]

_FloatArray = NDArray[np.float64]

# Least ratio of the points' two principal extents: below it the points are collinear to double precision.
_LEAST_FLATNESS = 1e-8
# Largest radius, in units of the points' rms distance from their centroid. So flat an arc has a sagitta of a
# millionth of its length, which no picture can show.
_LARGEST_RADIUS = 1e6
_STEP_TOLERANCE = 1e-11
_MAX_ITERATIONS = 200
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
    covariance : ndarray (3, 3) or None
        Of (centre, radius), to first order, for independent residuals of equal variance, which is estimated
        from them; None for three points, which leave no residual. **Residuals along an edge in a picture are
        correlated, and the true covariance is then larger**, by a factor of two or more in the deviations.
        `labrig.vision.curvature` works with means of blocks instead; no interval is printed from this matrix.
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
    covariance: _FloatArray | None
    residual_rms: float
    inliers: NDArray[np.bool_]
    influences: _FloatArray

    def residuals(self, points: ArrayLike) -> _FloatArray:
        """Return the signed orthogonal distances of points (N, 2), positive outside the circle."""
        offsets = np.asarray(points, dtype=np.float64) - np.asarray(self.centre)
        return np.asarray(np.hypot(offsets[:, 0], offsets[:, 1]) - self.radius)


class _Model(NamedTuple):
    """A circle in the normalised coordinates in which the fits work."""

    a: float
    b: float
    r: float

    def residuals(self, points: _FloatArray) -> _FloatArray:
        return np.asarray(np.hypot(points[:, 0] - self.a, points[:, 1] - self.b) - self.r)

    def linearise(self, points: _FloatArray) -> tuple[_FloatArray, _FloatArray]:
        """Return the residuals (N,) and their Jacobian (N, 3) with respect to (a, b, r)."""
        offsets = points - (self.a, self.b)
        distances = np.hypot(offsets[:, 0], offsets[:, 1])
        jacobian = np.empty((len(points), 3))
        # A point on the centre has no direction; its row is then zero in (a, b).
        jacobian[:, :2] = -offsets / np.maximum(distances, np.finfo(float).tiny)[:, None]
        jacobian[:, 2] = -1.0
        return distances - self.r, jacobian


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
    try:
        start = _find_least_median(normal)
        model, weights = _fit_tukey(normal, start, None if method == "robust" else np.inf)
    except np.linalg.LinAlgError:
        raise _collinear_error(len(array)) from None
    if not model.r < _LARGEST_RADIUS:
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


def _move(model: _Model, step: NDArray[np.floating]) -> _Model:
    return _Model(model.a + float(step[0]), model.b + float(step[1]), model.r + float(step[2]))


def _find_least_median(points: _FloatArray) -> _Model:
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
    return _Model(float(centres[best, 0]), float(centres[best, 1]), float(radii[best]))


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


def _fit_tukey(points: _FloatArray, start: _Model, known_scale: float | None) -> tuple[_Model, _FloatArray]:
    """Minimise Tukey's biweight from `start`; return the model and the weights (N,).

    A scale that is not known follows the residuals for the first, reweighted steps and is then held, so that a minimum
    exists.
    Reweighting alone converges slowly if many points are close to being outliers.
    """
    model, scale = start, known_scale or _robust_scale(start.residuals(points))
    for iteration in range(_MAX_ITERATIONS):
        residuals, jacobian = model.linearise(points)
        if known_scale is None and iteration < _SCALE_STEPS:
            scale = _robust_scale(residuals)
        weights = _biweight(residuals, scale)
        weighted = jacobian * weights[:, None]
        normal = weighted.T @ jacobian
        if np.linalg.cond(normal) > _LARGEST_RADIUS**2:
            raise _collinear_error(len(points))
        step = np.asarray(np.linalg.solve(normal, -weighted.T @ residuals), dtype=np.float64)
        if iteration >= _SCALE_STEPS:
            step = _choose_step(points, model, scale, step)
        model = _move(model, step)
        if iteration >= _SCALE_STEPS and np.abs(step).max() <= _STEP_TOLERANCE * max(1.0, model.r):
            return model, _biweight(model.residuals(points), scale)
    raise MeasurementRefusedError(
        f"the robust circle through {len(points)} points does not settle: they lie on no single circle",
        "leave out what is not on the arc",
    )


def _choose_step(points: _FloatArray, model: _Model, scale: float, step: _FloatArray) -> _FloatArray:
    """Return Newton's step if it lowers the cost at least as far as the reweighted `step`, else `step`."""
    residuals, jacobian = model.linearise(points)
    weights = _biweight(residuals, scale)
    normal = (jacobian * _slopes(weights)[:, None]).T @ jacobian
    if np.linalg.eigvalsh(normal)[0] <= 0.0:
        return step
    newton = np.linalg.solve(normal, -jacobian.T @ (weights * residuals))
    reweighted, sharp = (_tukey_cost(points, _move(model, trial), scale) for trial in (step, newton))
    return np.asarray(newton if sharp <= reweighted else step)


def _tukey_cost(points: _FloatArray, model: _Model, scale: float) -> float:
    return -float(np.sum(_biweight(model.residuals(points), scale) ** 1.5))


def _robust_scale(residuals: _FloatArray) -> float:
    """Return the standard deviation of the inliers, corrected for few points (Rousseeuw 1987, p. 202)."""
    correction = _MAD_TO_SIGMA * (1.0 + 5.0 / max(len(residuals) - 3, 1))
    return max(correction * float(np.median(np.abs(residuals))), _ROUNDING)


def _biweight(residuals: _FloatArray, scale: float) -> _FloatArray:
    ratio = np.minimum(np.abs(residuals) / (_TUKEY_CONSTANT * scale), 1.0)
    return np.asarray((1.0 - ratio * ratio) ** 2)


def _restore_units(
    model: _Model, normal: _FloatArray, weights: _FloatArray, centroid: _FloatArray, scale: float
) -> Circle:
    inliers = weights > 0.0
    residuals = model.residuals(normal)
    covariance = _covariance(model, normal, weights)
    return Circle(
        centre=(float(centroid[0] + scale * model.a), float(centroid[1] + scale * model.b)),
        radius=scale * model.r,
        covariance=None if covariance is None else covariance * scale**2,
        residual_rms=scale * float(np.sqrt(np.mean(residuals[inliers] ** 2))),
        inliers=inliers,
        influences=scale * weights * residuals / max(float(np.mean(_slopes(weights))), _LEAST_SLOPE),
    )


def _slopes(weights: _FloatArray) -> _FloatArray:
    """Return psi' (N,): psi = r (1 - q)^2 with q = (r / c)^2, so psi' = (1 - q)(1 - 5 q); unit weights have 1."""
    root = np.sqrt(weights)
    return np.asarray(root * (5.0 * root - 4.0))


def _covariance(model: _Model, points: _FloatArray, weights: _FloatArray) -> _FloatArray | None:
    """Return the first-order covariance of (a, b, r) for independent residuals.

    With weights it is Huber's for an M-estimate (Robust Statistics 1981, section 7.6), with sum(psi^2) and
    sum(psi') from the residuals; with unit weights it is the usual s^2 (J^T J)^-1.
    """
    count = len(points)
    if count <= 3:
        return None
    residuals, jacobian = model.linearise(points)
    spread = float(np.sum((weights * residuals) ** 2)) / (count - 3)
    slope = float(np.mean(_slopes(weights)))
    if slope <= 0.0:
        return None
    return np.asarray(np.linalg.inv(jacobian.T @ jacobian) * spread / slope**2)
