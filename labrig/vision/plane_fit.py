"""The map from points to paper, and its uncertainty that comes from a bend of the paper.

Paper at a height h above the needle's plane appears where that plane lies at p + (p - c) h / D, for a camera at the
distance D above the point c of the plane (plane and parallax). A bent sheet shows in the residuals, but the homography
absorbs most of the bend and is then wrong by as much. A second fit that includes the bend measures this error. If it
explains residuals, the maps with and without the bend count as one standard deviation apart. So do the heights of the
sheet, because the needle's plane may lie anywhere among them. In rendered pictures with paper bent by 0.4 mm the 95 %
intervals of the radius contained the truth in 58 of 100 without these variations, and in 40 of 40 with them.

The map is a homography, and one radial term without a known lens, by robust least squares. Every point takes part, but
points that are far off count less (soft L1, Triggs et al. 2000, Bundle adjustment, section 3.3). A point a quarter of a
pitch or more off is a false detection and is left out. The covariance is the sandwich estimate over blocks of
neighbouring points, because uneven paper displaces neighbours alike.

Through a valid plane map ruled paper has its own pitch in every direction. The deviation from that, as scales along two
axes and as distances of the points from an even grid, is compared before and after a run. The paper may be moved
in between, so its place and direction do not count; a camera that was bumped shows in scale and shape. A map whose
scale the paper contradicts is refused: the camera was moved since it was made.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import OptimizeResult, least_squares

from labrig.errors import CalibrationRefusedError, MeasurementRefusedError
from labrig.text import round_up
from labrig.vision.paper import find_paper
from labrig.vision.picture import Picture, require_size
from labrig.vision.plane import PlaneMap, Radial, apply_homography

FloatArray = NDArray[np.float64]

# A bend that explains less than this share of the squared residuals is noise.
_LEAST_EXPLAINED = 0.03
# Height of a trial bend, as a share of the camera's distance.
_TRIAL = 1e-3


def find_bent_homographies(px: FloatArray, paper_mm: FloatArray, foot_mm: FloatArray) -> list[FloatArray]:
    """Return other homographies that the bend of the paper allows; none if the paper shows no bend.

    Parameters
    ----------
    px : ndarray (N, 2)
        Ideal pixels of the crossings.
    paper_mm : ndarray (N, 2)
        Their places on the paper.
    foot_mm : ndarray (2,)
        The point of the paper's plane under the camera.
    """
    heights = _bend_shapes(paper_mm)
    away = paper_mm - foot_mm
    flat, left = _fit(px, paper_mm)
    trials = [_fit(px, paper_mm + _TRIAL * away * height[:, None])[1] for height in heights.T]
    design = np.column_stack([(trial - left) / _TRIAL for trial in trials])
    coefficients = -np.linalg.lstsq(design, left, rcond=None)[0]
    height = heights @ coefficients
    bent, rest = _fit(px, paper_mm + away * height[:, None])
    if float(rest @ rest) > (1.0 - _LEAST_EXPLAINED) * float(left @ left):
        return []
    return [bent, raise_paper(flat, float(np.std(height)), foot_mm)]


def raise_paper(homography: FloatArray, share: float, foot_mm: FloatArray) -> FloatArray:
    """Return the homography to the needle's plane, if the paper lies above it by a share of the camera's height."""
    raised = np.eye(3)
    raised[:2] = np.column_stack(((1.0 + share) * np.eye(2), -share * foot_mm))
    return np.asarray(raised @ homography)


def _bend_shapes(paper_mm: FloatArray) -> FloatArray:
    """Return the heights (N, 3) of a sheet bent along each axis and diagonally, without level and slope."""
    normal = (paper_mm - paper_mm.mean(axis=0)) / np.ptp(paper_mm, axis=0).max()
    a, b = normal.T
    bends = np.column_stack((a * a, a * b, b * b))
    plane = np.column_stack((a, b, np.ones(len(a))))
    return np.asarray(bends - plane @ np.linalg.lstsq(plane, bends, rcond=None)[0])


def _fit(px: FloatArray, paper_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the least-squares homography and its residuals (2 N,)."""
    found = fit_homography(px, paper_mm)
    return found, (apply_homography(found, px) - paper_mm).ravel()


def fit_homography(px: FloatArray, paper_mm: FloatArray) -> FloatArray:
    """Return the least-squares homography (3, 3) from pixels (N, 2) to places (N, 2).

    Raises
    ------
    CalibrationRefusedError
        If there is none: the points lie on one line, for instance.
    """
    found = cv2.findHomography(px, paper_mm)[0]
    if found is None:
        raise _no_plane_error()
    return np.asarray(found, dtype=np.float64)


_MAX_REFITS = 10
_HOMOGRAPHY = 8
# The radial term's centre may leave the picture's middle, because pictures are cropped. A weak prior holds it there: a
# distance of half a diagonal costs as much as one point's typical error.
_RADIAL = 3
# Residuals up to this many times their typical size count in full.
_FULL = 2.0
_MAD_TO_SIGMA = 1.4826
_LEAST_SCALE_MM = 1e-9
_LEAST_POINTS = 6


@dataclass(frozen=True, eq=False)
class PlaneFit:
    """The fit of points to the paper.

    Attributes
    ----------
    homography : ndarray (3, 3)
        From ideal pixels to paper [mm].
    radial : Radial or None
    kept : ndarray of bool (N,)
        Points that are not false detections.
    residuals_mm : ndarray (N, 2)
        From a point's place on the paper to its fitted place.
    jacobian : ndarray (2 M, P)
        Derivatives of the kept residuals, scaled so that J^T J is the second derivative of the cost.
    weighted_mm : ndarray (2 M,)
        The kept residuals with their robust weight, on that scale.
    parameters : ndarray (P,)
    """

    homography: FloatArray
    radial: Radial | None
    kept: NDArray[np.bool_]
    residuals_mm: FloatArray
    jacobian: FloatArray
    weighted_mm: FloatArray
    parameters: FloatArray
    _to_normal: FloatArray

    def paper_mm(self, ideal_or_px: FloatArray) -> FloatArray:
        """Return the places on the paper (N, 2) [mm] of ideal pixels, or of the picture's with a radial term."""
        return apply_homography(self.homography, self.paper_px(ideal_or_px))

    def paper_px(self, ideal_or_px: FloatArray) -> FloatArray:
        """Return the pixels (N, 2) that the homography takes: the radial term, if there is one, is undone."""
        return ideal_or_px if self.radial is None else self.radial.undistort_px(ideal_or_px)

    def vary_homography(self, blocks: NDArray[np.int64]) -> list[FloatArray]:
        """Return the homography moved by one standard deviation along each axis of its covariance.

        `blocks` (M,) numbers the block of neighbours of every kept point.
        """
        bread = np.linalg.pinv(self.jacobian.T @ self.jacobian)
        scores = self.jacobian * self.weighted_mm[:, None]
        clusters = np.zeros((int(blocks.max()) + 1, scores.shape[1]))
        np.add.at(clusters, np.repeat(blocks, 2), scores)
        covariance = bread @ (clusters.T @ clusters) @ bread
        part = covariance[:_HOMOGRAPHY, :_HOMOGRAPHY]
        values, vectors = np.linalg.eigh(0.5 * (part + part.T))
        moves = (vectors * np.sqrt(np.maximum(values, 0.0))).T
        padded = np.pad(moves, ((0, 0), (0, len(self.parameters) - _HOMOGRAPHY)))
        return [_shape(self.parameters + move) @ self._to_normal for move in padded]


def fit_plane(
    px: FloatArray,
    paper_mm: FloatArray,
    gross_mm: float,
    radial_about: tuple[float, float] | None = None,
) -> PlaneFit:
    """Fit points at pixels (N, 2) to their places on paper (N, 2) [mm].

    Parameters
    ----------
    px : ndarray (N, 2)
        Ideal pixels; with `radial_about`, the picture's own.
    gross_mm : float
        A point that is further off is a false detection.
    radial_about : (float, float), optional
        Pixel near the centre of one radial term that is fitted as well.

    Raises
    ------
    CalibrationRefusedError
        If no plane explains the points.
    """
    if len(px) < _LEAST_POINTS:
        raise _no_plane_error()
    # Pixels about the middle in units of half the diagonal of their extent, so that the fit is well scaled.
    middle = 0.5 * (px.min(axis=0) + px.max(axis=0)) if radial_about is None else np.array(radial_about)
    half = 0.5 * float(np.linalg.norm(np.ptp(px, axis=0)))
    to_normal = np.array([[1.0, 0.0, -middle[0]], [0.0, 1.0, -middle[1]], [0.0, 0.0, half]]) / half
    normal = (px - middle) / half
    # OpenCV's sampling has a fixed seed of its own.
    start = cv2.findHomography(normal, paper_mm, cv2.RANSAC, gross_mm)[0]
    if start is None or not abs(start[2, 2]) > 0.0:
        raise _no_plane_error()
    parameters = np.append(
        (start / start[2, 2]).ravel()[:_HOMOGRAPHY], [0.0] * _RADIAL * (radial_about is not None)
    )
    residuals = _predict(parameters, normal) - paper_mm
    kept = np.zeros(len(px), dtype=bool)
    for _ in range(_MAX_REFITS):
        last, kept = kept, np.hypot(*residuals.T) < gross_mm
        if (kept == last).all():
            break
        if kept.sum() < _LEAST_POINTS:
            raise _no_plane_error()
        scale = max(_MAD_TO_SIGMA * float(np.median(np.abs(residuals[kept]))), _LEAST_SCALE_MM)
        solved = _minimise(parameters, normal[kept], paper_mm[kept], scale)
        parameters = solved.x
        residuals = _predict(parameters, normal) - paper_mm
    radial = None
    if radial_about is not None:
        k, *centre = parameters[_HOMOGRAPHY:]
        u, v = (middle + half * np.array(centre)).tolist()
        radial = Radial(centre_px=(u, v), k_per_px2=float(k) / half**2)
    # SciPy scales its Jacobian by (1 + z)^(-3/4); the influence of a residual falls with (1 + z)^(-1/2).
    off = solved.fun[: 2 * kept.sum()]
    weighted = off * (1.0 + (off / (_FULL * scale)) ** 2) ** 0.25
    homography = _shape(parameters) @ to_normal
    return PlaneFit(
        homography, radial, kept, residuals, solved.jac[: len(off)], weighted, parameters, to_normal
    )


def _no_plane_error() -> CalibrationRefusedError:
    return CalibrationRefusedError(
        "no plane explains the paper's lines", "lay the paper flat and fill the picture with it"
    )


def _minimise(start: FloatArray, normal: FloatArray, paper_mm: FloatArray, scale_mm: float) -> OptimizeResult:
    def residuals(parameters: FloatArray) -> FloatArray:
        off = (_predict(parameters, normal) - paper_mm).ravel()
        return np.concatenate((off, scale_mm * parameters[_HOMOGRAPHY + 1 :]))

    return least_squares(residuals, start, loss="soft_l1", f_scale=_FULL * scale_mm, x_scale="jac")


def _shape(parameters: FloatArray) -> FloatArray:
    """Return the homography (3, 3) of parameters."""
    return np.append(parameters[:_HOMOGRAPHY], 1.0).reshape(3, 3)


def _predict(parameters: FloatArray, normal: FloatArray) -> FloatArray:
    """Return the places on the paper (N, 2) [mm] of normalised pixels (N, 2)."""
    if len(parameters) > _HOMOGRAPHY:
        k, *centre = parameters[_HOMOGRAPHY:]
        aside = normal - centre
        normal = centre + aside / (1.0 + k * np.sum(aside**2, axis=1))[:, None]
    return apply_homography(_shape(parameters), normal)


# Limits of a check through a map with ruled paper: points, and how far the map may be off: paper is true to 0.5 %, and
# paper in air where the map was made behind gel to 2 %. A point further off than this share of the pitch is false.
_LEAST_CHECKED, _LARGEST_DEVIATION, _GROSS = 24, 0.03, 0.25
_CALIBRATE_AGAIN = (
    "measure the lines of the paper with a ruler; if they are as stated, the camera was moved since the plane was "
    "calibrated: calibrate the plane again"
)
_LARGEST_DRIFT = 0.005
_LARGEST_BENDING_MM = 0.1


@dataclass(frozen=True)
class GridCheck:
    """Ruled paper seen through a plane map.

    Attributes
    ----------
    scale, other_scale : float
        Lengths through the map over true lengths: the largest and the least over all directions.
    residual_mm : float
        Rms distance of the points from an even grid with these scales.
    points : int
    """

    scale: float
    other_scale: float
    residual_mm: float
    points: int


@dataclass(frozen=True)
class GridDrift:
    """What changed between two checks.

    Attributes
    ----------
    relative : float
        Largest change of scale in any direction: the error bar of every length of the run.
    bending_mm : float
        Increase of the points' distance from an even grid.
    reason : str or None
        Why the change is too large for an error bar.
    """

    relative: float
    bending_mm: float
    reason: str | None

    @property
    def accepted(self) -> bool:
        """Whether an error bar covers the change."""
        return self.reason is None


def check_grid(image: Picture, plane: PlaneMap, pitch_mm: float) -> GridCheck:
    """Measure ruled paper of a known pitch through a plane map.

    Raises
    ------
    CalibrationRefusedError
        If too little of the paper is visible.
    PictureError
        If the picture has another size than the map is for.
    """
    require_size(image, plane.image_size, "the plane map")
    # The paper lies as when the plane was calibrated, in air; the gel comes afterwards.
    on_paper = plane.at_paper()
    middle = 0.5 * image.shape[1], 0.5 * image.shape[0]
    try:
        found = find_paper(image, pitch_mm / on_paper.mm_per_px_at(middle))
        seen = on_paper.to_mm(found.pixels)
    except MeasurementRefusedError as refusal:
        raise CalibrationRefusedError(refusal.message, _CALIBRATE_AGAIN) from refusal
    # OpenCV's sampling has a fixed seed of its own.
    affine, inside = cv2.estimateAffine2D(
        found.lines * float(pitch_mm), seen, ransacReprojThreshold=_GROSS * pitch_mm, refineIters=20
    )
    kept = np.ravel(inside) > 0
    if affine is None or kept.sum() < _LEAST_CHECKED:
        raise CalibrationRefusedError(
            f"{kept.sum()} points of ruled lines, {_LEAST_CHECKED} are needed", "show more of the paper"
        )
    off = np.hypot(*(found.lines[kept] * pitch_mm @ affine[:, :2].T + affine[:, 2] - seen[kept]).T)
    largest, least = np.linalg.svd(affine[:, :2], compute_uv=False)
    return GridCheck(float(largest), float(least), float(np.sqrt(np.mean(off**2))), int(kept.sum()))


def compare_grids(before: GridCheck, after: GridCheck) -> GridDrift:
    """Return what changed; refused if the change is too large for an error bar."""
    drift = max(abs(after.scale / before.scale - 1.0), abs(after.other_scale / before.other_scale - 1.0))
    bending = float(np.sqrt(max(after.residual_mm**2 - before.residual_mm**2, 0.0)))
    scale = max((before.scale, before.other_scale), key=lambda length: abs(length - 1.0))
    reason = None
    if abs(scale - 1.0) > _LARGEST_DEVIATION:
        reason = (
            f"Lengths on the graph paper before the run are {scale:.3f} times the true ones through the plane map, and "
            f"{100.0 * _LARGEST_DEVIATION:g} % off is the most: the camera was moved since the plane was calibrated, "
            "or the paper lay higher or lower then; calibrate the plane again."
        )
    elif drift > _LARGEST_DRIFT:
        reason = (
            f"Lengths changed by {round_up(100.0 * drift, 2)} % between the grid pictures before and after the run, "
            f"and {100.0 * _LARGEST_DRIFT:g} % is the most: the camera was bumped; calibrate the plane again."
        )
    elif bending > _LARGEST_BENDING_MM:
        reason = (
            f"The grid after the run is {round_up(bending, 2)} mm out of shape, and {_LARGEST_BENDING_MM:g} mm is the "
            "most: the camera was tilted, or the paper is bent; calibrate the plane again."
        )
    return GridDrift(drift, bending, reason)
