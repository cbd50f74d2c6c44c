"""The bend of a sheet of ruled paper that explains why its crossings are off a plane.

From a camera at height D above its foot C, a point of the sheet at height h above the plane appears at the plane's
point q if it lies at q + (C - q) h / D (plane and parallax, Kumar, Anandan & Hanna 1994). So a bent sheet moves every
crossing towards or away from one point, which distinguishes it from a lens. The height is a polynomial over the sheet
without level and slope, which belong to the plane. Its order is the lowest whose error, for crossings left out in
blocks, is close to the least of all orders. If the camera is unknown, its foot is fitted too. The bend then still
predicts crossings, but foot, radial term and height have the same effect, so no height is stated.

The bend explains why a sheet is refused. It never enters the map: a needle does not follow the paper's bend.
"""

from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.polynomial.legendre import legval
from numpy.typing import NDArray
from scipy.optimize import least_squares, minimize

from labrig.vision.plane import Bend
from labrig.vision.plane_fit import PlaneFit

_FloatArray = NDArray[np.float64]

_ORDERS = (2, 3, 4, 5)
# The lowest order is chosen whose error of left-out crossings is within this factor of the best order's.
_AS_GOOD = 1.05
# If less than this share of the variance exceeds the crossings' own noise, there is nothing to explain.
_LEAST_SMOOTH_SHARE = 0.1
# A crossing this many typical residuals off does not count.
_OUTLIER = 4.0
_MAD_TO_SIGMA = 1.4826
# Where the camera is known, a bend whose height is not above zero by so many standard deviations is none.
_LEAST_SIGMAS = 3.0
# Standard deviations of the prior: heights as shares of the camera's distance, the camera's foot from the sheet's
# middle in halves of its diagonal, and the parameters of the plane fit, which are of the order of one.
_PLAUSIBLE_HEIGHT = 0.1
_PLAUSIBLE_FOOT = 1.5
_PLAUSIBLE_MOVE = 1.0
# The highest order of the polynomial for the sheet's shortening by its slope.
_MOST_SHORTENING_ORDER = 7
# The fit with it takes four to thirty steps; where it takes more the height is left open by the picture.
_MOST_STEPS = 60
_DIFFERENCE = 1e-5
_FEET = tuple(product((-1.2, -0.4, 0.4, 1.2), repeat=2))


@dataclass(frozen=True, eq=False)
class _Sheet:
    """The crossings to which the bend is fitted; lengths are in halves of the sheet's diagonal, from its middle.

    `places` (N, 2) are fitted by the plane; `off` (N, 2) are their distances from the true places on the sheet; `moves`
    (N, 2, P) are the derivatives of `places` by the parameters of the plane fit; `foot` (2,) is the camera's, if known.
    """

    places: _FloatArray
    off: _FloatArray
    moves: _FloatArray
    noise: float
    foot: _FloatArray | None

    def columns(self, order: int) -> _FloatArray:
        """Return the terms (N, K) of the height at the crossings, without level and slope."""
        return _legendre(self.places, 2, order)

    def pull(self, foot: _FloatArray, order: int) -> _FloatArray:
        """Return how far (N, 2, K) each term of the height moves the crossings under a camera over `foot`."""
        return np.asarray((foot - self.places)[:, :, None] * self.columns(order)[:, None, :])


@dataclass(frozen=True, eq=False)
class _Surface:
    """A solution: moves of the plane's parameters (P,), the camera's foot (2,), coefficients of the height (K,)."""

    moves: _FloatArray
    foot: _FloatArray
    coefficients: _FloatArray
    order: int

    def heights(self, sheet: _Sheet) -> _FloatArray:
        """Return the heights (N,) as shares of the camera's distance; level and slope are arbitrary."""
        if not self.order:
            return np.zeros(len(sheet.places))
        return np.asarray(sheet.columns(self.order) @ self.coefficients)

    def residuals(self, sheet: _Sheet) -> _FloatArray:
        """Return the residuals (N, 2) of the crossings' places."""
        shift = (self.foot - sheet.places) * self.heights(sheet)[:, None]
        return np.asarray(sheet.off + sheet.moves @ self.moves + shift)


def find_bend(
    fit: PlaneFit,
    px: _FloatArray,
    pictured_px: _FloatArray,
    odd: NDArray[np.bool_],
    *,
    noise_mm: float,
    camera_mm: _FloatArray | None,
) -> Bend | None:
    """Return the sheet's bend; None if left-out crossings are predicted as well without a bend.

    With a known camera also None if the height is not significant: a bend whose height nothing bounds explains nothing.

    Parameters
    ----------
    px : ndarray (N, 2)
        The fitted pixels: ideal pixels, or, with a radial term, the picture's own.
    pictured_px : ndarray (N, 2)
        The same crossings in the picture.
    odd : ndarray of bool (N,)
        The half, in alternate blocks, to which each crossing belongs.
    noise_mm : float
        Rms noise of a single crossing.
    camera_mm : ndarray (3,) or None
        The camera's foot on the paper, and its height.
    """
    kept = fit.kept
    off = fit.residuals_mm[kept]
    if np.mean(np.sum(off**2, axis=1)) * (1.0 - _LEAST_SMOOTH_SHARE) <= noise_mm**2:
        return None
    places, moves = fit.paper_mm(px[kept]), fit.moves_mm(px[kept])
    middle = 0.5 * (places.min(axis=0) + places.max(axis=0))
    half = 0.5 * float(np.linalg.norm(np.ptp(places, axis=0)))
    foot = None if camera_mm is None else (camera_mm[:2] - middle) / half
    sheet = _Sheet((places - middle) / half, off / half, moves / half, noise_mm / half, foot)
    halves = (odd[kept], ~odd[kept])
    if min(part.sum() for part in halves) < _count_terms(_ORDERS[-1]) + moves.shape[2]:
        return None
    errors = {order: _measure_holdout(sheet, halves, order) for order in (0, *_ORDERS)}
    order = next(order for order, error in errors.items() if error <= _AS_GOOD * min(errors.values()))
    if order == 0:
        return None
    surface = _fit_surface(sheet, order)
    shift = half * np.linalg.norm(surface.residuals(sheet) - sheet.off, axis=1)
    most = int(np.argmax(shift))
    pictured = pictured_px[kept]
    bend = Bend(order, half * errors[order], float(shift[most]), _pixel(pictured, most))
    return bend if camera_mm is None else _add_height(bend, sheet, pictured, float(camera_mm[2]), half)


def _count_terms(order: int) -> int:
    return (order + 1) * (order + 2) // 2 - 3


def _select(sheet: _Sheet, part: NDArray[np.bool_]) -> _Sheet:
    return _Sheet(sheet.places[part], sheet.off[part], sheet.moves[part], sheet.noise, sheet.foot)


def _measure_holdout(sheet: _Sheet, halves: tuple[NDArray[np.bool_], ...], order: int) -> float:
    """Return the rms error of each half of the crossings for the surface fitted to the other half."""
    errors = [_fit_surface(_select(sheet, ~half), order).residuals(_select(sheet, half)) for half in halves]
    return float(np.sqrt(np.mean(np.sum(np.vstack(errors) ** 2, axis=1))))


def _pixel(px: _FloatArray, number: int) -> tuple[float, float]:
    return float(px[number, 0]), float(px[number, 1])


def _add_height(
    bend: Bend, sheet: _Sheet, px: _FloatArray, distance_mm: float, half_mm: float
) -> Bend | None:
    """Return the bend with its height, corrected for the sheet's shortening by its own slope; None if insignificant."""
    first = _fit_surface(sheet, bend.order)
    surface = _fit_shortened(sheet, first, distance_mm / half_mm)
    before, heights = (_remove_plane(sheet, found.heights(sheet)) for found in (first, surface))
    high, low = int(np.argmax(heights)), int(np.argmin(heights))
    # The shortening is known to first order only, so its whole effect counts as uncertain.
    height = float(heights[high] - heights[low])
    change = height - float(before[high] - before[low])
    sigma = float(
        np.hypot(_estimate_sigma(sheet, surface, (high, low), bend.holdout_rms_mm / half_mm), change)
    )
    if not height > _LEAST_SIGMAS * sigma:
        return None
    return replace(
        bend,
        height_mm=distance_mm * height,
        sigma_mm=distance_mm * sigma,
        highest_px=_pixel(px, high),
        lowest_px=_pixel(px, low),
    )


def _fit_shortened(sheet: _Sheet, first: _Surface, distance: float) -> _Surface:
    """Return the surface fitted together with its own shortening, from one that was fitted without.

    The two are fitted at once: to correct the places and fit again in turns diverges on all but the gentlest sheets.
    `distance` is the camera's, in halves of the diagonal.
    """
    shortening = _Shortening.of(sheet, first.order, distance)
    count = len(first.moves)
    pull = sheet.pull(first.foot, first.order)
    held = np.repeat([1.0 / _PLAUSIBLE_MOVE, 1.0 / _PLAUSIBLE_HEIGHT], (count, len(first.coefficients)))

    def residuals(at: _FloatArray) -> _FloatArray:
        places = sheet.off + sheet.moves @ at[:count] + pull @ at[count:] + shortening.places(at[count:])
        return np.concatenate((places.ravel() / sheet.noise, held * at))

    def jacobian(at: _FloatArray) -> _FloatArray:
        slopes = np.concatenate((sheet.moves, pull + shortening.derivatives(at[count:])), axis=2)
        return np.vstack((slopes.reshape(-1, len(at)) / sheet.noise, np.diag(held)))

    start = np.concatenate((first.moves, first.coefficients))
    found = least_squares(residuals, start, jacobian, method="lm", max_nfev=_MOST_STEPS).x
    return replace(first, moves=found[:count], coefficients=found[count:])


@dataclass(frozen=True, eq=False)
class _Shortening:
    """How much further out places are along the sheet than in projection: paper does not stretch.

    This is the least-squares displacement whose strain is half the square of the slope (Foeppl, von Karman). `slopes`
    (2, N, K) are those of the height's terms along either axis, against the best plane; the displacement has the terms
    (N, T), and `solver` (2 T, 3 N) gives their coefficients for a strain.
    """

    slopes: _FloatArray
    terms: _FloatArray
    solver: _FloatArray

    @classmethod
    def of(cls, sheet: _Sheet, order: int, distance: float) -> "_Shortening":
        level = np.linalg.lstsq(_plane_terms(sheet), sheet.columns(order), rcond=None)[0]
        gradient = np.stack(_differentiate_legendre(sheet.places, 2, order))
        highest = min(2 * order - 1, _MOST_SHORTENING_ORDER)
        right, down = _differentiate_legendre(sheet.places, 1, highest)
        none = np.zeros_like(right)
        strain = np.block([[right, none], [none, down], [down, right]])
        return cls(
            distance * (gradient - level[:2, None]),
            _legendre(sheet.places, 1, highest),
            np.linalg.pinv(strain),
        )

    def places(self, coefficients: _FloatArray) -> _FloatArray:
        """Return the displacements (N, 2)."""
        x, y = self.slopes @ coefficients
        return self._displace(np.concatenate((0.5 * x**2, 0.5 * y**2, x * y))[:, None])[..., 0]

    def derivatives(self, coefficients: _FloatArray) -> _FloatArray:
        """Return the derivatives (N, 2, K) of the displacements by the coefficients."""
        x, y = (self.slopes @ coefficients)[..., None]
        along_x, along_y = self.slopes
        return self._displace(np.concatenate((x * along_x, y * along_y, x * along_y + y * along_x)))

    def _displace(self, strain: _FloatArray) -> _FloatArray:
        found = (self.solver @ strain).reshape(2, self.terms.shape[1], -1)
        return np.asarray((self.terms @ found).transpose(1, 0, 2))


def _legendre(places: _FloatArray, lowest: int, order: int) -> _FloatArray:
    """Return products of Legendre polynomials (N, K) with total orders from `lowest` to `order`."""
    x, y = places.T
    rows = np.eye(order + 1)
    pairs = [(i, total - i) for total in range(lowest, order + 1) for i in range(total + 1)]
    return np.column_stack([legval(x, rows[i]) * legval(y, rows[j]) for i, j in pairs])


def _differentiate_legendre(places: _FloatArray, lowest: int, order: int) -> list[_FloatArray]:
    """Return the derivatives (N, K) of `_legendre` along either axis, by central differences."""
    steps = _DIFFERENCE * np.eye(2)
    return [
        (_legendre(places + step, lowest, order) - _legendre(places - step, lowest, order))
        / (2.0 * _DIFFERENCE)
        for step in steps
    ]


def _estimate_sigma(sheet: _Sheet, surface: _Surface, ends: tuple[int, int], left_out: float) -> float:
    """Return the standard deviation of the height of one crossing above another.

    Residuals along both axes count as independent, each as large as the error of crossings left out.
    """
    terms = sheet.columns(surface.order)
    design = np.concatenate((sheet.moves, sheet.pull(surface.foot, surface.order)), axis=2).reshape(
        2 * len(terms), -1
    )
    moves = sheet.moves.shape[2]
    held = np.repeat([_PLAUSIBLE_MOVE, _PLAUSIBLE_HEIGHT], (moves, terms.shape[1])) ** -2.0
    information = 2.0 * design.T @ design / left_out**2 + np.diag(held)
    high, low = _remove_plane(sheet, terms)[list(ends)]
    contrast = np.concatenate((np.zeros(moves), high - low))
    return float(np.sqrt(contrast @ np.linalg.solve(information, contrast)))


def _plane_terms(sheet: _Sheet) -> _FloatArray:
    return np.column_stack((sheet.places, np.ones(len(sheet.places))))


def _remove_plane(sheet: _Sheet, heights: _FloatArray) -> _FloatArray:
    design = _plane_terms(sheet)
    return np.asarray(heights - design @ np.linalg.lstsq(design, heights, rcond=None)[0])


def _fit_surface(sheet: _Sheet, order: int) -> _Surface:
    """Return the least-squares surface, fitted a second time without outliers."""
    first = _solve(sheet, order)
    off = np.linalg.norm(first.residuals(sheet), axis=1)
    near = off <= _OUTLIER * _MAD_TO_SIGMA * float(np.median(off))
    return _solve(_select(sheet, near), order)


def _solve(sheet: _Sheet, order: int) -> _Surface:
    """Return the surface. For a given camera's foot the problem is linear, so only the foot is searched for."""
    count = sheet.moves.shape[2]
    if order == 0:
        return _Surface(_Normal.of(sheet, 0).solution(np.zeros(2))[0], np.zeros(2), np.empty(0), 0)
    normal = _Normal.of(sheet, order)
    foot = sheet.foot
    if foot is None:

        def cost(at: _FloatArray) -> float:
            return normal.solution(at)[1] + float(at @ at) * (sheet.noise / _PLAUSIBLE_FOOT) ** 2

        start = min((np.array(at) for at in _FEET), key=cost)
        foot = np.asarray(minimize(cost, start, method="Nelder-Mead", options={"xatol": 1e-3}).x)
    solution = normal.solution(foot)[0]
    return _Surface(solution[:count], foot, solution[count:], order)


@dataclass(frozen=True, eq=False)
class _Normal:
    """Normal equations for any foot (a, b): a term t of the height moves a place by (a, b) t - place t.

    `gram` is the Gram matrix of the columns: the plane's moves, the terms along either axis, place times term, `off`.
    """

    gram: _FloatArray
    moves: int
    terms: int
    noise: float

    @classmethod
    def of(cls, sheet: _Sheet, order: int) -> "_Normal":
        terms = sheet.columns(order) if order else np.empty((len(sheet.places), 0))
        zero = np.zeros_like(terms)
        rows = [
            np.column_stack(
                (
                    sheet.moves[:, axis],
                    zero if axis else terms,
                    terms if axis else zero,
                    sheet.places[:, axis, None] * terms,
                    sheet.off[:, axis],
                )
            )
            for axis in (0, 1)
        ]
        columns = np.vstack(rows)
        return cls(columns.T @ columns, sheet.moves.shape[2], terms.shape[1], sheet.noise)

    def solution(self, foot: _FloatArray) -> tuple[_FloatArray, float]:
        """Return the least-squares parameters and their cost, with the prior."""
        eye = np.eye(self.terms)
        chosen = np.zeros((len(self.gram), self.moves + self.terms))
        chosen[: self.moves, : self.moves] = np.eye(self.moves)
        chosen[self.moves : -1, self.moves :] = np.vstack((foot[0] * eye, foot[1] * eye, -eye))
        held = np.repeat(
            [self.noise / _PLAUSIBLE_MOVE, self.noise / _PLAUSIBLE_HEIGHT], (self.moves, self.terms)
        )
        matrix = chosen.T @ self.gram @ chosen + np.diag(held**2)
        wanted = -chosen.T @ self.gram[:, -1]
        found: _FloatArray = np.asarray(np.linalg.solve(matrix, wanted), dtype=np.float64)
        return found, float(self.gram[-1, -1] - wanted @ found)
