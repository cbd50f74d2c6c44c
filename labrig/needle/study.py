"""Figure 3 on our own contour: rotations over a grid of clearance and inclination, the plane through them, a design."""

from collections.abc import Callable, Sequence
from concurrent.futures import Executor, as_completed
from dataclasses import dataclass
from functools import partial

import numpy as np

from labrig.errors import AnswerIsNoError
from labrig.needle.equations import EQUATION_3, RotationPlane, rotation_for_radius_deg
from labrig.needle.hinge import Hinge, widest_clearance_mm
from labrig.needle.search import DEFAULT_SEED, HingeRotation, allowed_rotation
from labrig.needle.tube import Tube

GRID_POINTS = 7
# The paper does not print the range of its figure 3. Ours has the paper's design near its middle.
STEEPEST_CUT_DEG = 8.0
_LOWEST_SHARE, _HIGHEST_SHARE = 0.4, 1.6
# Steps that bring a design to its rotation; the search is sure to a thousandth of a degree.
_STEPS = 4
_CLOSE_ENOUGH_DEG = 0.005
_SMALLER = "ask for a smaller radius, or cut with a smaller clearance"

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class Cell:
    """One point of the grid: clearance, inclination, and what both hinges allow."""

    clearance_mm: float
    beta_cut_deg: float
    beta_a_deg: float
    beta_b_deg: float

    @property
    def beta_rot_deg(self) -> float:
        """Equation (2)."""
        return self.beta_a_deg + self.beta_b_deg


def design_by_equations(tube: Tube, radius_mm: float, clearance_mm: float) -> Hinge:
    """Return the hinge that equations (1) and (3) ask for; quick, and it refuses whatever can be refused of a design.

    Raises
    ------
    InputError
        When the clearance or the radius is beyond its limit, or the inclination would cut the link through.
    AnswerIsNoError
        When the clearance alone lets the hinges turn further.
    """
    Hinge(tube, clearance_mm, beta_cut_deg=0.0)
    beta_rot_deg = rotation_for_radius_deg(radius_mm, tube.link_length_mm)
    return Hinge(tube, clearance_mm, EQUATION_3.beta_cut_deg(beta_rot_deg, clearance_mm))


def grid_of_hinges(tube: Tube, clearance_mm: float, points: int = GRID_POINTS) -> tuple[Hinge, ...]:
    """Return points x points hinges: clearances around the one given, each with inclinations from 0 to 8 degrees.

    Clearances go from 0.4 to 1.6 times the one given (0.010 to 0.040 mm for the paper's 0.025), or as far as
    the widest that still holds the knuckle at 8 degrees.
    """
    widest_mm = min(_HIGHEST_SHARE * clearance_mm, 0.999 * widest_clearance_mm(tube, STEEPEST_CUT_DEG))
    clearances_mm = np.linspace(_LOWEST_SHARE * clearance_mm, widest_mm, points)
    cuts_deg = np.linspace(0.0, STEEPEST_CUT_DEG, points)
    return tuple(Hinge(tube, float(d), float(cut)) for d in clearances_mm for cut in cuts_deg)


def search_cells(
    hinges: Sequence[Hinge], executor: Executor, progress: Progress | None = None, seed: int = DEFAULT_SEED
) -> tuple[Cell, ...]:
    """Search the rotations of every hinge; the answer does not depend on the executor.

    Parameters
    ----------
    hinges : sequence of Hinge
    executor : concurrent.futures.Executor
        Does the searches.
    progress : callable or None
        Called with how many are done, and how many there are.
    seed : int
        Of every search.
    """
    futures = [executor.submit(partial(allowed_rotation, seed=seed), hinge) for hinge in hinges]
    for done, _ in enumerate(as_completed(futures), start=1):
        if progress is not None:
            progress(done, len(futures))
    return tuple(_cell(hinge, future.result()) for hinge, future in zip(hinges, futures, strict=True))


def _cell(hinge: Hinge, found: HingeRotation) -> Cell:
    return Cell(
        hinge.clearance_mm, hinge.beta_cut_deg, found.hinge_a.rotation_deg, found.hinge_b.rotation_deg
    )


def fit_plane(cells: Sequence[Cell]) -> RotationPlane:
    """Fit a plane of the form of equation (3) by least squares."""
    design = np.array([[cell.beta_cut_deg, cell.clearance_mm, 1.0] for cell in cells])
    rotations_deg = np.array([cell.beta_rot_deg for cell in cells])
    (a, b, c), *_ = np.linalg.lstsq(design, rotations_deg)
    left_deg = rotations_deg - design @ (a, b, c)
    return RotationPlane(float(a), float(b), float(c), rmse_deg=float(np.sqrt(np.mean(left_deg**2))))


@dataclass(frozen=True)
class SearchedDesign:
    """A hinge whose searched rotations give the radius asked for."""

    hinge: Hinge
    rotation: HingeRotation


def search_design(
    tube: Tube, radius_mm: float, clearance_mm: float, plane: RotationPlane, seed: int = DEFAULT_SEED
) -> SearchedDesign:
    """Find the inclination at which the searched hinges give a radius, starting from the fitted plane.

    Parameters
    ----------
    plane : RotationPlane
        Fitted to cells of the same tube; its slope is what each step goes by.

    Raises
    ------
    InputError
        When the inclination would cut the link through.
    AnswerIsNoError
        When the clearance alone lets the hinges turn further.
    """
    wanted_deg = rotation_for_radius_deg(radius_mm, tube.link_length_mm)
    # The plane is not exact: whether the clearance alone is too much is seen by searching that hinge.
    beta_cut_deg = max((wanted_deg - plane.beta_rot_deg(0.0, clearance_mm)) / plane.a, 0.0)
    for _ in range(_STEPS):
        hinge = Hinge(tube, clearance_mm, beta_cut_deg)
        found = allowed_rotation(hinge, seed)
        missing_deg = wanted_deg - found.beta_rot_deg
        if abs(missing_deg) < _CLOSE_ENOUGH_DEG:
            return SearchedDesign(hinge, found)
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
