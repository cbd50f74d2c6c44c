"""The largest rotation of a hinge without interference: a global search over two translations and a rotation.

The paper perturbs the links in the plane, and a genetic algorithm finds the limits "under the contour interference
constraints". Here scipy's differential evolution (Storn and Price 1997) does. Interference is the exact area that
the polygons share, computed by shapely. It is a constraint, not a penalty: a pose without interference beats every
pose with interference, so the result is free of it.
"""

from dataclasses import dataclass
from functools import partial
from typing import Any, Final

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.optimize import Bounds, NonlinearConstraint, differential_evolution

from labrig.errors import AnswerIsNoError
from labrig.needle.hinge import Hinge, HingeView, LinkPair
from labrig.needle.kinematics import FloatArray

DEFAULT_SEED: Final = 20_210_530
_POPULATION_PER_VARIABLE = 15
_MOST_GENERATIONS = 500
# The search has settled when its poses agree to a thousandth of a degree.
_SETTLED_DEG = 1e-3


@dataclass(frozen=True)
class FreeRotation:
    """The largest rotation of a hinge to one side, and the translation that allows it.

    The contours are symmetric, so the other side has the same rotation.
    """

    rotation_deg: float
    lateral_mm: float
    axial_mm: float


@dataclass(frozen=True)
class GridPoint:
    """A hinge, by clearance and inclination, and the rotations of both hinges of a pair in the plane of bending."""

    clearance_mm: float
    beta_cut_deg: float
    beta_a_deg: float
    beta_b_deg: float

    @property
    def beta_rot_deg(self) -> float:
        """Equation (2): beta_rot = beta_a + beta_b."""
        return self.beta_a_deg + self.beta_b_deg


def search_rotations(hinge: Hinge, seed: int = DEFAULT_SEED) -> GridPoint:
    """Search the rotations that two adjacent, orthogonal hinges allow in the plane of bending."""
    a, b = (search_largest_rotation(view, seed) for view in (hinge.hinge_a(), hinge.hinge_b()))
    return GridPoint(hinge.clearance_mm, hinge.beta_cut_deg, a.rotation_deg, b.rotation_deg)


def search_largest_rotation(view: HingeView, seed: int = DEFAULT_SEED) -> FreeRotation:
    """Search the largest rotation without interference.

    Parameters
    ----------
    view : HingeView
        Sections that must stay free, and the search box.
    seed : int
        Of the differential evolution; the same seed gives the same result.

    Raises
    ------
    AnswerIsNoError
        If the search does not settle.
    """
    # Hinge a has one maximum, with the socket aside of the middle. Hinge b has one at each end of its play along the
    # pin: a search of its whole box ended at the lower, by a few hundredths of a degree, once in a hundred times.
    play_mm = view.box.lateral_mm
    halves = ((-play_mm, 0.0), (0.0, play_mm)) if view.pin_in_plane else ((0.0, play_mm),)
    return max((_search_between(view, half, seed) for half in halves), key=lambda found: found.rotation_deg)


def _search_between(view: HingeView, lateral_mm: tuple[float, float], seed: int) -> FreeRotation:
    """Search the box between two lateral translations."""
    least = np.array([0.0, lateral_mm[0], -view.box.axial_mm])
    found = differential_evolution(
        _negate_rotation,
        bounds=Bounds(least, np.array([view.box.rotation_deg, lateral_mm[1], view.box.axial_mm])),
        constraints=NonlinearConstraint(partial(_measure_constraint, view), -np.inf, 0.0),
        popsize=_POPULATION_PER_VARIABLE,
        maxiter=_MOST_GENERATIONS,
        tol=0.0,
        atol=_SETTLED_DEG,
        rng=seed,
        polish=False,
        vectorized=True,
        updating="deferred",
    )
    if not found.success:
        raise AnswerIsNoError(
            f"the search for the largest rotation did not settle: {found.message}", "try another seed"
        )
    return FreeRotation(*map(float, found.x))


def interference_mm2(view: HingeView, poses: FloatArray) -> FloatArray:
    """Return the area that both links share, summed over the sections.

    Parameters
    ----------
    view : HingeView
    poses : ndarray (3, S) or (3,)
        Rotation about the pin [degrees, clockwise], then lateral and axial translation [mm] of the socket link.

    Returns
    -------
    ndarray (S,)
        Exactly 0 without interference.
    """
    columns = np.reshape(poses, (3, -1))
    shared: FloatArray = np.sum([_measure_shared_area(pair, columns) for pair in view.sections], axis=0)
    return shared


def _measure_shared_area(pair: LinkPair, poses: FloatArray) -> FloatArray:
    moved = _move_socket(pair, poses)
    shared = np.zeros(len(moved))
    # Most poses touch nothing, and that test is ten times as fast as a shared area.
    touching = shapely.intersects(pair.knuckle, moved)
    shared[touching] = shapely.area(shapely.intersection(pair.knuckle, moved[touching]))
    return shared


def _move_socket(pair: LinkPair, poses: FloatArray) -> NDArray[np.object_]:
    """Return the socket link in each pose."""
    rotation_rad = np.radians(poses[0])[:, None]
    cos, sin = np.cos(rotation_rad), np.sin(rotation_rad)
    x, z = shapely.get_coordinates(pair.socket).T
    corners = np.stack(
        [cos * x + sin * z + poses[1][:, None], cos * z - sin * x + poses[2][:, None]], axis=-1
    )
    shapely.prepare(pair.knuckle)
    copies = np.full(poses.shape[1], pair.socket, dtype=object)
    moved: NDArray[np.object_] = shapely.set_coordinates(copies, corners.reshape(-1, 2))
    return moved


def _negate_rotation(poses: FloatArray) -> Any:
    """Return what scipy minimises, a value per pose; its type stubs allow only a single pose."""
    return -poses[0]


def _measure_constraint(view: HingeView, poses: FloatArray) -> FloatArray:
    """Return the shared area in the shape that scipy expects: (1, S) for S poses, (1,) for a single pose."""
    shared_mm2 = interference_mm2(view, poses)
    return shared_mm2[None, :] if poses.ndim > 1 else shared_mm2
