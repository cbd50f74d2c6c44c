"""The default method in the plane: enumerate and score, and search more closely if nothing is found.

Paths of up to four arcs are enumerated, and the best is taken. If there is none, the tree grows finer and deeper,
twice, thinned to one tip a cell, and other ends within the tolerance are tried too. A narrow tunnel is missed by all
of them, because no angle of the tree leads through. So the tree last grows among smaller obstacles, and its paths are
mended until they keep off the true ones.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labrig.needle.kinematics import FloatArray
from labrig.steering.mending import mend_paths, rank_by_lack
from labrig.steering.planar import (
    Field,
    Tips,
    close_paths,
    find_hits,
    grow_tips,
    join_paths,
    make_psi,
    pick_evenly,
    start_tree,
    target_in_plane,
    thin_tips,
)
from labrig.steering.problem import Surroundings
from labrig.steering.score import pick_best_feasible

_SCORED, _RANKED = 160, 1000
_ENDS = 8
_END_SHARE = 0.85
# Rounds that a moving needle can wait for, and rounds without mending.
QUICK_ROUNDS, CLOSER_ROUNDS = 1, 3
# By how much smaller the obstacles are among which paths are sought to be mended [mm].
_SMALLER_MM = (0.4, 1.2)
_MENDED, _MENDING_STEPS = 64, 24


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


def search_plane(around: Surroundings, known: Sequence[FloatArray]) -> Iterator[FloatArray | None]:
    """Yield the best path (n, 2) of a planar problem from each round, or None; later rounds take longer.

    Paths (M, n, 2) that are known are compared with those of the first.
    """
    field, target = Field.from_surroundings(around), target_in_plane(around)
    yield _search_first(around, field, target, _FIRST, known)
    tolerance_mm = np.sqrt(max(around.problem.tolerance_mm**2 - around.target_mm[0] ** 2, 0.0))
    ring = _END_SHARE * tolerance_mm * np.exp(2j * np.pi * np.arange(_ENDS) / _ENDS)
    targets = np.concatenate(([target], target + ring))
    for effort in _CLOSER:
        yield _search_closer(around, field, targets, effort)
    if len(field.discs):
        for smaller_mm in _SMALLER_MM:
            yield _search_mended(around, field.with_smaller_discs(smaller_mm), target)


def _search_first(
    around: Surroundings, field: Field, target: complex, effort: Effort, known: Sequence[FloatArray]
) -> FloatArray | None:
    """Return the best path of up to four arcs or of those that are known, or None."""
    tips, found = start_tree(), [_make_single_arcs(around, target)]
    for level in range(min(around.problem.max_arcs - 1, len(effort.samples) + 1)):
        if level:
            tips = grow_tips(tips, field, effort.samples[level - 1])
        found.append(_close_clear(tips, field, target, _SCORED))
    return pick_best_feasible((*found, *known), around)


def _search_closer(
    around: Surroundings, field: Field, targets: NDArray[np.complex128], effort: Effort
) -> FloatArray | None:
    """Return the best of the paths with the fewest arcs in a finer tree, or None."""
    tips = start_tree()
    for level in range(around.problem.max_arcs - 1):
        if level:
            tips = _grow_thinly(tips, field, effort, level)
        for target in targets:
            path = pick_best_feasible([_close_clear(tips, field, target, _SCORED)], around)
            if path is not None:
                return path
    return None


def _search_mended(around: Surroundings, field: Field, target: complex) -> FloatArray | None:
    """Return the best of the paths with the fewest arcs that were mended, or None; the field has smaller discs."""
    tips = start_tree()
    for level in range(around.problem.max_arcs - 1):
        if level:
            tips = _grow_thinly(tips, field, _CLOSER[0], level)
        found = _close_clear(tips, field, target, _RANKED)
        if len(found):
            kept = rank_by_lack(found, around, _MENDED)
            path = pick_best_feasible([mend_paths(kept, around, _MENDING_STEPS)], around)
            if path is not None:
                return path
    return None


def _grow_thinly(tips: Tips, field: Field, effort: Effort, level: int) -> Tips:
    return thin_tips(
        grow_tips(tips, field, effort.samples[level - 1]), effort.cell_mm, effort.cell_rad, effort.tips
    )


def _close_clear(tips: Tips, field: Field, target: complex, most: int) -> FloatArray:
    """Return collision-free paths (M, n, 2) that end these tips with two more arcs.

    There are at most so many: the shortest, and an even selection of the others.
    """
    closures = close_paths(tips, field, target)
    clear = np.flatnonzero(~np.any(find_hits(closures, tips, field, target), axis=1))
    family, keys = join_paths(tips, closures, clear), closures.keys[clear]
    order = np.argsort(np.round(family[..., 0].sum(axis=1), 9), kind="stable")
    shortest, others = order[: most // 2], order[most // 2 :]
    return family[np.concatenate((shortest, others[pick_evenly(keys[others], most - most // 2)]))]


def _make_single_arcs(around: Surroundings, target: complex) -> FloatArray:
    """Return the one arc of each sign that passes nearest to the target, (2, 1, 2)."""
    signs = np.array([1.0, -1.0])
    # The angle at the arc's centre, from the start to the target.
    ray = (target - 1j * signs * around.problem.radius_mm) * 1j * signs
    return make_psi(np.mod(np.angle(ray) * signs, 2 * np.pi)[:, None], signs)
