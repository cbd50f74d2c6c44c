"""The gel's depth or index, and the tilt of its surface, from paper pictured bare and again through the gel.

Paper seen through a gel of depth d and index n appears nearer by about d (1 - 1/n), so larger. Its map in air turns the
crossings of the second picture into straight places; refraction must bring them back onto an even grid of the paper's
own pitch. The paper may move or turn in its plane between the pictures, but not leave it. Depth and index have nearly
the same effect, so one is stated and the other fitted.

The covariance is the sandwich estimate over blocks of neighbouring crossings, as in `plane_fit`; the uncertainty of the
map in air, and that of what is stated of the gel, are added.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from labrig.errors import CalibrationRefusedError, InputError, MeasurementRefusedError
from labrig.vision.graph_paper import find_crossings
from labrig.vision.picture import Picture, require_size
from labrig.vision.plane import PlaneMap
from labrig.vision.refraction import Gel, GelMeasurement, Quantity
from labrig.vision.rounding import round_up

_FloatArray = NDArray[np.float64]

_LEAST_CROSSINGS = 60
# The paper's scale through the gel differs by a few percent; another one is that of other lines.
_LARGEST_SCALE_ERROR = 0.2
_LARGEST_RMS_MM = 0.05
# What is searched: depth [mm] or index, the slopes of the surface, and the paper's turn [rad] and shift [mm].
_LOWEST, _HIGHEST = (-0.3, -0.3, -0.1, -20.0, -20.0), (0.3, 0.3, 0.1, 20.0, 20.0)
_RANGES: dict[Quantity, tuple[float, float]] = {"depth": (0.01, 1000.0), "index": (1.001, 1.99)}
_NEARLY = 0.999
# A gel is there if its depth, or its index above that of air, is so many standard deviations.
_LEAST_SIGMAS = 3.0
# Side of the blocks of crossings whose errors count as correlated.
_BLOCK = 5
_MAD_TO_SIGMA = 1.4826
_FULL = 2.0
_LEAST_SCALE_MM = 1e-6
_GROSS = 0.25
_DIFFERENCE = 1e-6


@dataclass(frozen=True, eq=False)
class SeenThrough:
    """A picture of the same paper through the gel, and which quantity of the gel it is to give.

    Attributes
    ----------
    picture : ndarray of uint8, (H, W) or (H, W, 3)
    quantity : "depth" or "index"
        The other one is that of the stated gel.
    """

    picture: Picture
    quantity: Quantity


def measure_gel(bare: PlaneMap, gel: Gel, seen: SeenThrough, pitch_mm: float) -> tuple[Gel, GelMeasurement]:
    """Return the gel with the fitted quantity, its tilt and their standard deviations, and the evidence.

    Parameters
    ----------
    bare : PlaneMap
        From the same paper in air, in the needle's place, by the same camera.
    gel : Gel
        What is stated; its value of the wanted quantity is where the search starts.

    Raises
    ------
    InputError
        If the lens is telecentric, the paper lay elsewhere, or (as PictureError) the picture has another size.
    CalibrationRefusedError
        If the paper is not found, or no gel explains it.
    """
    _check_inputs(bare, gel)
    require_size(seen.picture, bare.image_size, "the picture of the bare paper")
    try:
        found = find_crossings(seen.picture)
        straight = bare.to_mm(found.pixels)
    except MeasurementRefusedError as refusal:
        raise CalibrationRefusedError(f"through the gel: {refusal.message}", refusal.hint) from refusal
    unplaced = np.asarray(found.indices * float(pitch_mm), dtype=np.float64)
    paper, kept = _align_paper(unplaced, straight, _GROSS * found.step * pitch_mm)
    problem = _Problem(gel, seen.quantity, paper[kept])
    places, centre = straight[kept], bare.camera_centre()
    solution = problem.solve(places, centre)
    off = problem.residuals(solution, places, centre)
    rms_mm = float(np.sqrt(2.0 * np.mean(off**2)))
    moved = [
        *(
            problem.residuals(solution, variant.to_mm(found.pixels[kept]), variant.camera_centre())
            for variant in bare.variants()
        ),
        *(other.residuals(solution, places, centre) for other in problem.vary()),
    ]
    blocks = np.unique(found.indices[kept] // (_BLOCK * found.step), axis=0, return_inverse=True)[1].ravel()
    sigmas = _find_sigmas(problem.differentiate(solution, places, centre), off, np.array(moved), blocks)
    _require_gel(problem, solution, float(sigmas[0]), rms_mm)
    return problem.finish(solution, sigmas, centre, rms_mm)


def _check_inputs(bare: PlaneMap, gel: Gel) -> None:
    if bare.telecentric:
        raise InputError(
            "through a telecentric lens a gel changes no scale, so it cannot be measured",
            "measure the gel's depth with a ruler",
        )
    if gel.paper != "needle":
        raise InputError(
            f"the paper was stated to lie at {gel.paper!r}, and a gel is measured with paper at 'needle'",
            "picture the paper in air in the needle's place, then again through the gel",
        )


def _align_paper(
    paper_mm: _FloatArray, straight_mm: _FloatArray, gross_mm: float
) -> tuple[_FloatArray, NDArray[np.bool_]]:
    """Return the crossings' places (N, 2) turned and shifted to where they appear, and which are no false detections.

    Raises
    ------
    CalibrationRefusedError
        If too few are seen, or at another scale than the paper's.
    """
    design = np.column_stack((paper_mm, np.ones(len(paper_mm))))
    kept = np.ones(len(paper_mm), dtype=bool)
    for _ in range(3):
        affine = np.linalg.lstsq(design[kept], straight_mm[kept], rcond=None)[0]
        kept = np.hypot(*(design @ affine - straight_mm).T) < gross_mm
        if kept.sum() < _LEAST_CROSSINGS:
            raise CalibrationRefusedError(
                f"{kept.sum()} crossings of ruled lines are seen through the gel, {_LEAST_CROSSINGS} are needed",
                "show more of the paper, through a clear and flat surface",
            )
    u, scales, v = np.linalg.svd(affine[:2].T)
    if np.abs(scales - 1.0).max() > _LARGEST_SCALE_ERROR:
        raise CalibrationRefusedError(
            f"through the gel the paper's lines are {scales.mean():.2f} times as far apart as in air",
            "picture the same paper in the same place, with the same camera",
        )
    turned = paper_mm @ (u @ v).T
    return turned + np.mean(straight_mm[kept] - turned[kept], axis=0), kept


@dataclass(frozen=True, eq=False)
class _Problem:
    """Crossings at places (N, 2) of the paper, and the gel through which they are seen.

    The parameters are the wanted quantity, the two slopes of the surface, and the paper's turn and shift in its plane.
    """

    gel: Gel
    quantity: Quantity
    paper_mm: _FloatArray

    def make_gel(self, parameters: _FloatArray) -> Gel:
        value, along_y, along_z = map(float, parameters[:3])
        gel = replace(self.gel, tilt_rad=(float(np.arctan(along_y)), float(np.arctan(along_z))))
        return replace(gel, depth_mm=value) if self.quantity == "depth" else replace(gel, index=value)

    def residuals(
        self, parameters: _FloatArray, straight_mm: _FloatArray, centre: _FloatArray
    ) -> _FloatArray:
        """Return by how much the gel brings straight rays (N, 2) off the paper's crossings (2 N,) [mm]."""
        turn, middle = parameters[3], self.paper_mm.mean(axis=0)
        aside = self.paper_mm - middle
        turned = np.cos(turn) * aside + np.sin(turn) * np.column_stack((-aside[:, 1], aside[:, 0]))
        return np.asarray(
            (self.make_gel(parameters).bend(straight_mm, centre) - middle - turned - parameters[4:]).ravel()
        )

    def solve(self, straight_mm: _FloatArray, centre: _FloatArray) -> _FloatArray:
        """Return the parameters by robust least squares."""
        low, high = _RANGES[self.quantity]
        start = np.array(
            [self.gel.depth_mm if self.quantity == "depth" else self.gel.index, 0.0, 0.0, 0.0, 0.0, 0.0]
        )
        for _ in range(2):
            off = np.abs(self.residuals(start, straight_mm, centre))
            solved = least_squares(
                self.residuals,
                start,
                bounds=((low, *_LOWEST), (high, *_HIGHEST)),
                loss="soft_l1",
                f_scale=_FULL * max(_MAD_TO_SIGMA * float(np.median(off)), _LEAST_SCALE_MM),
                x_scale="jac",
                args=(straight_mm, centre),
            )
            start = np.asarray(solved.x)
        return start

    def differentiate(
        self, parameters: _FloatArray, straight_mm: _FloatArray, centre: _FloatArray
    ) -> _FloatArray:
        """Return the derivatives (2 N, 6) of the residuals, by central differences."""
        steps = _DIFFERENCE * np.eye(len(parameters))
        columns = [
            self.residuals(parameters + step, straight_mm, centre)
            - self.residuals(parameters - step, straight_mm, centre)
            for step in steps
        ]
        return np.column_stack(columns) / (2.0 * _DIFFERENCE)

    def vary(self) -> list["_Problem"]:
        """Return the problem with each stated quantity moved by one standard deviation."""
        stated = self._state_sigma(None)
        return [replace(self, gel=moved) for moved in replace(stated, tilt_sigma_rad=None).vary()]

    def _state_sigma(self, sigma: float | None, gel: Gel | None = None) -> Gel:
        """Return a gel, or else the stated one, with another standard deviation of the wanted quantity."""
        if self.quantity == "depth":
            return replace(gel or self.gel, depth_sigma_mm=sigma)
        return replace(gel or self.gel, index_sigma=sigma)

    def finish(
        self, solution: _FloatArray, sigmas: _FloatArray, centre: _FloatArray, rms_mm: float
    ) -> tuple[Gel, GelMeasurement]:
        """Return the gel and the evidence. The gel's depth is that at the origin as it is seen through the gel."""
        found = self.make_gel(solution)
        origin = found.bend(np.zeros((1, 2)), centre)
        found = replace(
            found, depth_mm=float(found.depths_mm(origin)[0]), tilt_sigma_rad=float(sigmas[1:3].max())
        )
        value, sigma = (found.depth_mm if self.quantity == "depth" else found.index), float(sigmas[0])
        along_y, along_z = np.rad2deg(found.tilt_rad)
        evidence = GelMeasurement(
            self.quantity,
            value,
            sigma,
            (float(along_y), float(along_z)),
            float(np.rad2deg(sigmas[1:3].max())),
            rms_mm,
            len(self.paper_mm),
        )
        return self._state_sigma(sigma, found), evidence


def _require_gel(problem: _Problem, solution: _FloatArray, sigma: float, rms_mm: float) -> None:
    """Refuse a picture that no gel explains.

    Raises
    ------
    CalibrationRefusedError
        With the residual, or with the quantity that the picture would give.
    """
    low, high = _RANGES[problem.quantity]
    # No gel is one without depth, or of the index of air.
    none = 0.0 if problem.quantity == "depth" else 1.0
    if not max(low, none + _LEAST_SIGMAS * sigma) < solution[0] < _NEARLY * high:
        raise CalibrationRefusedError(
            f"no gel explains the paper seen through it: its {problem.quantity} would be {solution[0]:.3g} ± "
            f"{sigma:.2g}{' mm' if problem.quantity == 'depth' else ''}",
            "picture the paper in air and then through the gel, and move neither paper nor camera in between",
        )
    if rms_mm > _LARGEST_RMS_MM:
        raise CalibrationRefusedError(
            f"seen through the gel, crossings are {round_up(rms_mm, 3)} mm off an even grid, the limit is "
            f"{_LARGEST_RMS_MM} mm",
            "give the gel a flat surface, and leave the paper flat and in its place",
        )


def _find_sigmas(
    jacobian: _FloatArray, off: _FloatArray, moved: _FloatArray, blocks: NDArray[np.int64]
) -> _FloatArray:
    """Return the standard deviations of the parameters.

    Parameters
    ----------
    jacobian : ndarray (2 N, P)
    off : ndarray (2 N,)
        The residuals.
    moved : ndarray (V, 2 N)
        The residuals with something else moved by one standard deviation each.
    blocks : ndarray (N,)
        Number of each crossing's block of neighbours.
    """
    inverse = np.linalg.pinv(jacobian)
    scores = np.zeros((int(blocks.max()) + 1, jacobian.shape[1]))
    np.add.at(scores, np.repeat(blocks, 2), jacobian * off[:, None])
    bread = np.linalg.pinv(jacobian.T @ jacobian)
    random = np.diag(bread @ (scores.T @ scores) @ bread)
    systematic = np.sum(((moved - off) @ inverse.T) ** 2, axis=0) if len(moved) else 0.0
    return np.asarray(np.sqrt(random + systematic))
