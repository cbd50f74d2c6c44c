"""Figure 3 on our own contour: rotations on a grid of clearance and inclination, the fitted plane, and a design."""

from collections.abc import Sequence

import numpy as np

from labrig.errors import AnswerIsNoError
from labrig.needle.equations import EQUATION_3, RotationPlane, rotation_for_radius_deg
from labrig.needle.hinge import THINNEST_CLEARANCE_MM, Hinge, widest_clearance_mm
from labrig.needle.rotation_search import DEFAULT_SEED, GridPoint, search_rotations
from labrig.protocol.design_file import Tube

GRID_POINTS = 7
# The paper does not print the range of its figure 3. Ours has the paper's design near its middle.
STEEPEST_CUT_DEG = 8.0
_LOWEST_SHARE, _HIGHEST_SHARE = 0.4, 1.6
# Steps in which a design reaches its rotation; the search is accurate to a thousandth of a degree.
_STEPS = 4
_CLOSE_ENOUGH_DEG = 0.005
_SMALLER = "ask for a smaller radius, or cut with a smaller clearance"


def design_by_equations(tube: Tube, radius_mm: float, clearance_mm: float) -> Hinge:
    """Return the hinge by equations (1) and (3); quick, and it refuses every design that can be refused.

    Raises
    ------
    InputError
        If the clearance or the radius exceeds its limit, or the inclination would cut through the link.
    AnswerIsNoError
        If the clearance alone lets the hinges turn further.
    """
    Hinge(tube, clearance_mm, beta_cut_deg=0.0)
    beta_rot_deg = rotation_for_radius_deg(radius_mm, tube.link_length_mm)
    return Hinge(tube, clearance_mm, EQUATION_3.beta_cut_deg(beta_rot_deg, clearance_mm))


def make_hinge_grid(tube: Tube, clearance_mm: float, points: int = GRID_POINTS) -> tuple[Hinge, ...]:
    """Return points x points hinges: clearances around the given clearance, each with inclinations from 0 to 8 degrees.

    They range from 0.4 to 1.6 times the given clearance (0.010 to 0.040 mm for the paper's 0.025), as far as a laser
    cuts so finely, and a clearance so wide still holds the knuckle at 8 degrees.
    """
    widest_mm = min(_HIGHEST_SHARE * clearance_mm, 0.999 * widest_clearance_mm(tube, STEEPEST_CUT_DEG))
    clearances_mm = np.linspace(max(_LOWEST_SHARE * clearance_mm, THINNEST_CLEARANCE_MM), widest_mm, points)
    cuts_deg = np.linspace(0.0, STEEPEST_CUT_DEG, points)
    return tuple(Hinge(tube, float(d), float(cut)) for d in clearances_mm for cut in cuts_deg)


def fit_plane(cells: Sequence[GridPoint]) -> RotationPlane:
    """Fit a plane of the form of equation (3) by least squares."""
    design = np.array([[cell.beta_cut_deg, cell.clearance_mm, 1.0] for cell in cells])
    rotations_deg = np.array([cell.beta_rot_deg for cell in cells])
    (a, b, c), *_ = np.linalg.lstsq(design, rotations_deg)
    left_deg = rotations_deg - design @ (a, b, c)
    return RotationPlane(float(a), float(b), float(c), rmse_deg=float(np.sqrt(np.mean(left_deg**2))))


def search_design(
    tube: Tube, radius_mm: float, clearance_mm: float, plane: RotationPlane, seed: int = DEFAULT_SEED
) -> GridPoint:
    """Find the inclination at which the searched hinges give a radius, starting from the fitted plane.

    Parameters
    ----------
    plane : RotationPlane
        Fitted to the grid of the same tube; each step uses its slope.

    Raises
    ------
    InputError
        If the inclination would cut through the link.
    AnswerIsNoError
        If the clearance alone lets the hinges turn further.
    """
    wanted_deg = rotation_for_radius_deg(radius_mm, tube.link_length_mm)
    # The plane is not exact: only a search of that hinge shows whether the clearance alone is too much.
    beta_cut_deg = max((wanted_deg - plane.beta_rot_deg(0.0, clearance_mm)) / plane.a, 0.0)
    for _ in range(_STEPS):
        found = search_rotations(Hinge(tube, clearance_mm, beta_cut_deg), seed)
        missing_deg = wanted_deg - found.beta_rot_deg
        if abs(missing_deg) < _CLOSE_ENOUGH_DEG:
            return found
        if beta_cut_deg == 0.0 and missing_deg < 0.0:
            raise AnswerIsNoError(
                f"no inclination gives {wanted_deg:.4g} degrees: a clearance of {clearance_mm:g} mm alone allows "
                f"{found.beta_rot_deg:.4g}",
                _SMALLER,
            )
        beta_cut_deg = max(beta_cut_deg + missing_deg / plane.a, 0.0)
    raise AnswerIsNoError(
        f"no inclination was found that gives {wanted_deg:.4g} degrees at a clearance of {clearance_mm:g} mm",
        _SMALLER,
    )
