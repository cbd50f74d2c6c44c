"""The default method in the plane: enumerate and score, and search more closely if nothing is found.

Paths of up to four arcs are enumerated, and the best is taken. If there is none, the tree grows finer and deeper,
twice, thinned to one tip a cell, and other ends within the tolerance are tried too.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labrig.needle.kinematics import FloatArray
from labrig.steering.planar import (
    Closures,
    Field,
    Tips,
    close_paths,
    find_hits,
    first_signs,
    grow_tips,
    make_psi,
    start_tree,
    target_in_plane,
    thin_tips,
)
from labrig.steering.problem import Surroundings
from labrig.steering.score import pick_best_feasible

_SCORED = 160
_ENDS = 8
_END_SHARE = 0.85


@dataclass(frozen=True)
class Effort:
    """How finely a tree grows: angles of each successive arc, cells for thinning, and the most tips of a level."""

    samples: tuple[int, ...]
    cell_mm: float
    cell_rad: float
    tips: int


_FIRST = Effort((56, 32), 0.0, 0.0, 0)
_CLOSER = (
    Effort((120, 48, 24, 20, 16, 16, 16, 16, 16, 16), 1.2, 0.06, 2500),
    Effort((240, 64, 48, 32, 24, 24, 16, 16, 16, 16), 0.5, 0.03, 12_000),
)


def search_plane(around: Surroundings, *, thorough: bool) -> FloatArray | None:
    """Return the best path (n, 2) of a planar problem, or None; a thorough search also tries finer trees."""
    field, target = Field.from_surroundings(around), target_in_plane(around)
    quick = _search_first(around, field, target, _FIRST)
    if quick is not None or not thorough:
        return quick
    tolerance_mm = np.sqrt(max(around.problem.tolerance_mm**2 - around.target_mm[0] ** 2, 0.0))
    ring = _END_SHARE * tolerance_mm * np.exp(2j * np.pi * np.arange(_ENDS) / _ENDS)
    targets = np.concatenate(([target], target + ring))
    paths = (_search_closer(around, field, targets, effort) for effort in _CLOSER)
    return next((path for path in paths if path is not None), None)


def _search_first(around: Surroundings, field: Field, target: complex, effort: Effort) -> FloatArray | None:
    """Return the best path of up to four arcs, or None."""
    tips, found = start_tree(), [_make_single_arcs(around, target)]
    for level in range(min(around.problem.max_arcs - 1, len(effort.samples) + 1)):
        if level:
            tips = grow_tips(tips, field, effort.samples[level - 1])
        found.append(_close_clear(tips, field, target))
    return _pick_best(found, around)


def _search_closer(
    around: Surroundings, field: Field, targets: NDArray[np.complex128], effort: Effort
) -> FloatArray | None:
    """Return the best of the paths with the fewest arcs in a finer tree, or None."""
    tips = start_tree()
    for level in range(around.problem.max_arcs - 1):
        if level:
            tips = grow_tips(tips, field, effort.samples[level - 1])
            tips = thin_tips(tips, effort.cell_mm, effort.cell_rad, effort.tips)
        for target in targets:
            path = _pick_best([_close_clear(tips, field, target)], around)
            if path is not None:
                return path
    return None


def _close_clear(tips: Tips, field: Field, target: complex) -> FloatArray:
    """Return the collision-free paths (M, n, 2) that end these tips with two more arcs."""
    closures = close_paths(tips, field, target)
    clear = ~np.any(find_hits(closures, tips, field, target), axis=1)
    return _join_paths(tips, closures, np.flatnonzero(clear))


def _join_paths(tips: Tips, closures: Closures, which: NDArray[np.intp]) -> FloatArray:
    """Return paths (M, n, 2) of these closures."""
    parents = tips.take(closures.parent[which])
    angles = np.concatenate((parents.angles_rad, closures.angles_rad[which]), axis=1)
    return make_psi(angles, first_signs(parents))


def _make_single_arcs(around: Surroundings, target: complex) -> FloatArray:
    """Return the one arc of each sign that passes nearest to the target, (2, 1, 2)."""
    signs = np.array([1.0, -1.0])
    # The angle at the arc's centre, from the start to the target.
    ray = (target - 1j * signs * around.problem.radius_mm) * 1j * signs
    return make_psi(np.mod(np.angle(ray) * signs, 2 * np.pi)[:, None], signs)


def _pick_best(families: list[FloatArray], around: Surroundings) -> FloatArray | None:
    """Return the best feasible path of all families, checked again in three dimensions, or None."""
    families = [_thin_family(family) for family in families]
    arcs = max(family.shape[1] for family in families)
    padded = [np.pad(family, ((0, 0), (0, arcs - family.shape[1]), (0, 0))) for family in families]
    return pick_best_feasible(np.concatenate(padded), around)


def _thin_family(family: FloatArray) -> FloatArray:
    """Return a family small enough to score: its shortest paths and an even selection of the others."""
    if len(family) <= _SCORED:
        return family
    order = np.argsort(family[..., 0].sum(axis=1))
    shortest, others = order[: _SCORED // 2], order[_SCORED // 2 :]
    return np.asarray(family[np.concatenate((shortest, others[:: 1 + 2 * len(others) // _SCORED]))])
