"""A plane map through gel and walls: its frame, the fit of paper that lies in the gel, and its uncertainty.

Paper in the gel is seen through the surfaces like the needle. The straight rays, without refraction, then reach the
paper's plane at other places than the crossings, and the homography is fitted to these. They depend on the camera's
place, which the homography gives, so both are found in turn; each turn leaves about a hundredth of the error. Such a
sheet is flat, where a homography alone would call it bent, and the map hardly depends on the gel's index and depth.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from labrig.errors import CalibrationRefusedError
from labrig.vision.plane import PlaneMap, Variation, apply_homography
from labrig.vision.plane_fit import PlaneFit
from labrig.vision.refraction import Gel
from labrig.vision.rounding import round_down, round_up
from labrig.vision.steering_frame import SteeringFrame

_FloatArray = NDArray[np.float64]

# The end of the origin's ray moves with the frame; each shift leaves a thousandth of the error.
_MAX_SHIFTS = 6
_MAX_TURNS = 8
_TOLERANCE_MM = 1e-6
# Gel that may explain a sheet that looks bent, and how much more error it may leave than the bend.
_TRIAL_INDEX, _TRIAL_DEPTH_MM = 1.35, 1.0
_AS_GOOD = 1.1


@dataclass(frozen=True, eq=False)
class SunkenPaper:
    """The fit of paper in the gel.

    Attributes
    ----------
    frame : SteeringFrame
    fit : PlaneFit
        Of the straight rays' places.
    paper_mm : ndarray (N, 2)
        The crossings' places on the paper.
    straight_mm : ndarray (N, 2)
        Where the rays to the crossings would reach the paper's plane without refraction.
    """

    frame: SteeringFrame
    fit: PlaneFit
    paper_mm: _FloatArray
    straight_mm: _FloatArray


def anchor_origin(plane: PlaneMap) -> PlaneMap:
    """Return a map through a gel, moved in its plane until the ray of the origin's pixel ends at (0, 0)."""
    shift = np.eye(3)
    for _ in range(_MAX_SHIFTS):
        moved = replace(plane, homography=shift @ plane.homography)
        shift[:2, 2] -= moved.to_mm([plane.origin_px])[0]
    variations = tuple(
        replace(variation, homography=shift @ variation.homography) for variation in plane.variations
    )
    return replace(plane, homography=shift @ plane.homography, variations=variations)


def require_room(plane: PlaneMap, gel: Gel) -> None:
    """Refuse a gel that reaches the camera, with its walls and standard deviations.

    Raises
    ------
    CalibrationRefusedError
        With the gel's depth and the camera's height.
    InputError
        If the camera's place is unknown.
    """
    centre = plane.camera_centre()
    height_mm = -float(centre[0]) if centre[3] else np.inf
    # With its standard deviation too, or the map could not be moved by it.
    depth_mm = max(other.height_mm() for other in (gel, *gel.vary()))
    if depth_mm >= height_mm:
        raise CalibrationRefusedError(
            f"the gel's depth is {depth_mm:.4g} mm, and the camera is only {round_down(height_mm, 0)} mm above "
            "the paper",
            "measure from the gel's surface to the needle, in mm",
        )


def judge_tilt(plane: PlaneMap) -> list[str]:
    """Return where tilted surfaces would reach the needle's plane inside the picture."""
    width, height = plane.image_size or (1, 1)
    if plane.gel is None or not any(plane.gel.tilt_rad):
        return []
    corners = [(0.0, 0.0), (width - 1.0, 0.0), (0.0, height - 1.0), (width - 1.0, height - 1.0)]
    depths_mm = plane.gel.depths_mm(plane.to_mm(corners))
    if depths_mm.min() > 0.0:
        return []
    u, v = corners[int(depths_mm.argmin())]
    below = round_up(-float(depths_mm.min()), 2)
    reason = (
        f"the tilted surface of the gel lies {below} mm below the needle's plane at ({u:.0f}, {v:.0f}) px: check the "
        "signs of the tilt, and the depth at the origin"
    )
    return [reason]


def fit_sunken_paper(
    plane: PlaneMap,
    frame: SteeringFrame,
    first: PlaneFit,
    paper_mm: _FloatArray,
    refit: Callable[[_FloatArray], PlaneFit],
) -> SunkenPaper:
    """Fit paper in the gel.

    Parameters
    ----------
    plane : PlaneMap
        Lens, origin and gel; its homography does not count.
    frame : SteeringFrame
    first : PlaneFit
        Of the crossings to the paper, without refraction.
    paper_mm : ndarray (N, 2)
        The crossings' places on the paper.
    refit : callable
        Fits the crossings to other places (N, 2) [mm].
    """
    fit, straight = first, paper_mm
    for _ in range(_MAX_TURNS):
        last, straight = straight, _find_straight_mm(plane, frame, fit.homography, paper_mm)
        fit = refit(straight)
        if np.abs(straight - last).max() <= _TOLERANCE_MM:
            break
    return SunkenPaper(frame, fit, paper_mm, straight)


def find_gel_depth_mm(
    plane: PlaneMap,
    frame: SteeringFrame,
    fit: PlaneFit,
    paper_mm: _FloatArray,
    ideal: _FloatArray,
    *,
    rms_mm: float,
) -> float | None:
    """Return the depth of gel under which flat paper would look as it was fitted in air; None if there is none.

    What refraction leaves of a homography grows with the depth, so one trial depth gives its shape.

    Parameters
    ----------
    plane : PlaneMap
        The map in air.
    rms_mm : float
        Error of crossings left out with a bend, which the gel has to explain as well.
    """
    px, places = fit.paper_px(ideal)[fit.kept], paper_mm[fit.kept]
    under = replace(plane, gel=Gel(_TRIAL_INDEX, _TRIAL_DEPTH_MM, "gel"))
    straight = _find_straight_mm(under, frame, fit.homography, places)
    in_air, in_gel = (
        (apply_homography(np.asarray(cv2.findHomography(px, to)[0], dtype=np.float64), px) - to).ravel()
        for to in (places, straight)
    )
    shape = in_gel - in_air
    share = -float(in_air @ shape) / float(shape @ shape)
    left_mm = float(np.sqrt(2.0 * np.mean((in_air + share * shape) ** 2)))
    return share * _TRIAL_DEPTH_MM if share > 0.0 and left_mm <= _AS_GOOD * rms_mm else None


def find_surface_variations(
    plane: PlaneMap, sunken: SunkenPaper | None, ideal: _FloatArray
) -> tuple[Variation, ...]:
    """Return the variations of a map by the standard deviations of its gel.

    Paper in air fixes the straight rays, and the gel moves their ends. Paper in the gel fixes the ends, and the gel
    moves the straight rays, which are fitted again.

    Parameters
    ----------
    plane : PlaneMap
        With its origin in place.
    sunken : SunkenPaper or None
        None for paper in air.
    ideal : ndarray (N, 2)
        Ideal pixels of the crossings.
    """
    variations = []
    for moved in () if plane.gel is None else plane.gel.vary():
        other = replace(plane, gel=moved, variations=())
        if sunken is not None:
            other = replace(other, homography=sunken.frame.transform(_refit(other, sunken, ideal)))
        variations.append(Variation(anchor_origin(other).homography, None, "surface", moved))
    return tuple(variations)


def _refit(plane: PlaneMap, sunken: SunkenPaper, ideal: _FloatArray) -> _FloatArray:
    """Return the homography to the paper (3, 3) that another gel leads to.

    Least squares without weights give the change; the weighted fit itself stays where it is.
    """
    kept, fitted = sunken.fit.kept, sunken.fit.homography
    px = sunken.fit.paper_px(ideal)[kept]
    straight = _find_straight_mm(plane, sunken.frame, fitted, sunken.paper_mm)[kept]
    before, after = (cv2.findHomography(px, places)[0] for places in (sunken.straight_mm[kept], straight))
    return np.asarray(fitted @ np.linalg.inv(before) @ after, dtype=np.float64)


def _find_straight_mm(
    plane: PlaneMap, frame: SteeringFrame, homography: _FloatArray, paper_mm: _FloatArray
) -> _FloatArray:
    """Return where rays to points of the paper (N, 2) would reach its plane without refraction, on the paper's axes."""
    placed = anchor_origin(replace(plane, homography=frame.transform(homography), variations=()))
    to_frame = placed.homography @ np.linalg.inv(homography)
    places = apply_homography(to_frame, paper_mm)
    straight = places if placed.gel is None else placed.gel.straighten(places, placed.camera_centre())
    return apply_homography(np.linalg.inv(to_frame), straight)
