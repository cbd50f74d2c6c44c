"""The planner: a problem in, a path or the reason why there is none out."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import chain, islice
from typing import Literal

import numpy as np

from labrig.needle.kinematics import FloatArray, path_frames, path_points
from labrig.steering import planar_search, spatial_search
from labrig.steering.clearance import path_distances
from labrig.steering.mending import mend_paths
from labrig.steering.parameters import PlanMethod
from labrig.steering.problem import PlanProblem, Point, Surroundings
from labrig.steering.refusal import RefusalCause, explain_failure, find_refusal
from labrig.steering.resolved_rate import search_by_resolved_rate
from labrig.steering.score import find_worst_miss_and_gap, pick_best_feasible

Effort = Literal["quick", "closer", "thorough", "improving"]
"""How long a search goes on without a path: as long as a moving needle can wait, without mending, or to its end.

"improving" goes on with a path too: for some rounds a better one is sought than the first, which has few arcs. They
take a quarter of a second before the needle moves, and what they find costs up to a sixth less.
"""

_IMPROVING_ROUNDS = 6
_MENDING_STEPS = 5


@dataclass(frozen=True)
class PlannedArc:
    """One arc: how far the bevel turns before it, `roll_rad`, and its angle and length."""

    roll_rad: float
    angle_rad: float
    length_mm: float


@dataclass(frozen=True)
class Plan:
    """A path, or why there is none.

    Parameters
    ----------
    found : bool
    reason, cause : str or None
        Why there is no path, in words and by its name; None if there is a path.
    hint : str
        What would give one.
    arcs : tuple of PlannedArc
        Empty if there is no path, or if the tip is already at the target.
    tip_mm : (x, y, z) or None
        Where the path ends, in the world frame.
    target_error_mm, length_mm : float or None
    clearance_mm : float or None
        Smallest distance from the needle's surface to an obstacle's; None without obstacles.
    worst_target_error_mm, worst_clearance_mm : float or None
        The same for a needle with the worst radius of its tolerance that follows the path open loop; None without
        a stated tolerance. A clearance below 0 means that the needle would cut an obstacle.
    """

    found: bool
    reason: str | None
    cause: RefusalCause | None = None
    hint: str = ""
    arcs: tuple[PlannedArc, ...] = ()
    tip_mm: Point | None = None
    target_error_mm: float | None = None
    clearance_mm: float | None = None
    length_mm: float | None = None
    worst_target_error_mm: float | None = None
    worst_clearance_mm: float | None = None

    @property
    def psi(self) -> FloatArray:
        """The configuration, (n, 2), columns (theta, delta)."""
        return np.array([(arc.angle_rad, arc.roll_rad) for arc in self.arcs]).reshape(-1, 2)

    def to_json(self) -> dict[str, object]:
        """Return the plan with the keys of `labrig plan`, except for the time it took."""
        return {**vars(self), "arcs": [vars(arc) for arc in self.arcs]}


def plan_path(
    problem: PlanProblem,
    method: PlanMethod = "best",
    effort: Effort = "thorough",
    present: FloatArray | None = None,
) -> Plan:
    """Return the first path to the target that is found, or the reason why there is none.

    Parameters
    ----------
    problem : PlanProblem
    method : {"best", "paper"}
        "best" enumerates paths (in the plane) or starts many times (free rolls), and takes the best feasible path of
        the first round that has one; "paper" is the paper's resolved motion rate with null-space avoidance, made
        robust, for comparison.
    effort : {"quick", "closer", "thorough", "improving"}
        Of "best". It is a number of rounds and not a time, so that the same problem has the same plan on any machine.
        Without a path the thorough search takes seconds, which is too long while the needle moves.
    present : (n, 2) array, optional
        The path that the needle follows, from the problem's start, columns (theta, delta). Mended, it is compared with
        those that are found: a quick search finds paths of few arcs only.
    """
    around = Surroundings(problem)
    refusal = find_refusal(around)
    if refusal is not None:
        return _refuse(*refusal)
    known = (
        [] if present is None or method == "paper" else [mend_paths(present[None], around, _MENDING_STEPS)]
    )
    search = _search_in_rounds(around, known, method, effort)
    rounds = _IMPROVING_ROUNDS if effort == "improving" else 1
    found = [psi for psi in islice(search, rounds) if psi is not None]
    cheapest = found if len(found) < 2 else [pick_best_feasible([psi[None] for psi in found], around)]
    best = next((psi for psi in chain(cheapest, search) if psi is not None), None)
    if best is not None and _is_worth_making(best, around):
        return make_plan(best, around)
    if np.linalg.norm(around.target_mm) <= problem.tolerance_mm:
        return make_plan(np.zeros((0, 2)), around)
    return _refuse(*explain_failure(problem, method))


def _refuse(reason: str, cause: RefusalCause, hint: str) -> Plan:
    return Plan(found=False, reason=reason, cause=cause, hint=hint)


def sample_path(problem: PlanProblem, plan: Plan, points_per_arc: int = 40) -> FloatArray:
    """Return points along a plan in the world frame, (N, 3), the start first."""
    start = np.asarray(problem.start, dtype=float)
    fractions = np.arange(1, points_per_arc + 1) / points_per_arc
    points = path_points(plan.psi, problem.radius_mm, fractions).reshape(-1, 3)
    return np.asarray(np.vstack((np.zeros(3), points)) @ start[:3, :3].T + start[:3, 3])


def _search_in_rounds(
    around: Surroundings, known: Sequence[FloatArray], method: PlanMethod, effort: Effort
) -> Iterator[FloatArray | None]:
    """Yield the best path of each round, or None."""
    if method == "paper":
        return iter([search_by_resolved_rate(around)])
    if around.problem.planar:
        most = {"quick": planar_search.QUICK_ROUNDS, "closer": planar_search.CLOSER_ROUNDS}.get(effort)
        return islice(planar_search.search_plane(around, known), most)
    most = spatial_search.QUICK_ROUNDS if effort == "quick" else None
    return islice(spatial_search.search_space(around, known), most)


def _is_worth_making(psi: FloatArray, around: Surroundings) -> bool:
    """Return whether a path at least halves the distance of a tip that is already within the tolerance."""
    distance = np.linalg.norm(around.target_mm)
    if distance > around.problem.tolerance_mm:
        return True
    tip = path_frames(psi, around.problem.radius_mm).positions_mm[-1]
    return bool(np.linalg.norm(tip - around.target_mm) < distance / 2)


def make_plan(psi: FloatArray, around: Surroundings) -> Plan:
    """Return a path (n, 2) as a plan with its figures."""
    problem = around.problem
    start = np.asarray(problem.start, dtype=float)
    arcs = tuple(PlannedArc(_wrap(roll), angle, problem.radius_mm * angle) for angle, roll in psi.tolist())
    path = psi if len(psi) else np.zeros((1, 2))
    frames = path_frames(path, problem.radius_mm)
    tip = frames.positions_mm[-1]
    x, y, z = (start[:3, :3] @ tip + start[:3, 3]).tolist()
    worst = (None, None) if problem.radius_range_mm is None else find_worst_miss_and_gap(psi, around)
    gaps_mm = (
        path_distances(path, problem.radius_mm, around.centres_mm, frames) - around.needle_and_obstacle_mm
    )
    return Plan(
        found=True,
        reason=None,
        arcs=arcs,
        tip_mm=(x, y, z),
        target_error_mm=float(np.linalg.norm(tip - around.target_mm)),
        clearance_mm=float(gaps_mm.min()) if problem.obstacles else None,
        length_mm=float(problem.radius_mm * psi[:, 0].sum()),
        worst_target_error_mm=worst[0],
        worst_clearance_mm=worst[1],
    )


def _wrap(roll_rad: float) -> float:
    """Return the roll in (-pi, pi]."""
    return math.pi - (math.pi - roll_rad) % (2 * math.pi)
