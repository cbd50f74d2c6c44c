"""Exact distances from paths of arcs to the centres of spheres, without sampling.

In the plane of an arc, the nearest point to a sphere's centre lies on the ray from the arc's centre to it if that ray
meets the arc. Otherwise it is an end of the arc.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labrig.needle.kinematics import ArcFrames, FloatArray, path_frames

_ROUNDING_MM = 1e-9


@dataclass(frozen=True, eq=False)
class NearestPlaces:
    """The place on each of M paths that is nearest to each of K points.

    distances_mm : (M, K); places_mm : (M, K, 3) in {1b}; arcs : (M, K), the arc of each place.
    """

    distances_mm: FloatArray
    places_mm: FloatArray
    arcs: NDArray[np.intp]

    def take(self, which: NDArray[np.intp]) -> "NearestPlaces":
        """Return those of a selection of paths."""
        return NearestPlaces(self.distances_mm[which], self.places_mm[which], self.arcs[which])


def arc_distances(
    psi: FloatArray, radius_mm: float, centres_mm: FloatArray, frames: ArcFrames | None = None
) -> FloatArray:
    """Return the distance from each arc's centre line to each point.

    Parameters
    ----------
    psi : (..., n, 2) array
        Paths, columns (theta, delta); 0 <= theta < 2 pi.
    radius_mm : float
    centres_mm : (K, 3) array
        In {1b}.
    frames : ArcFrames, optional
        Of the paths, if they are known already.

    Returns
    -------
    (..., n, K) array
    """
    return _measure_arcs(psi, radius_mm, centres_mm, frames or path_frames(psi, radius_mm))[0]


def _measure_arcs(
    psi: FloatArray, radius_mm: float, centres_mm: FloatArray, frames: ArcFrames
) -> tuple[FloatArray, FloatArray]:
    """Return the distance from each arc to each point (..., n, K), and the nearest place's angle before its end."""
    angles, offsets = psi[..., 0, None], centres_mm - frames.positions_mm[..., None, :]  # (..., n + 1, K, 3)
    # An arc bends in the y-z plane of the frame at its end, about the point (0, -r).
    local = offsets[..., 1:, :, :] @ frames.rotations[..., 1:, :, :]
    across, along = local[..., 1] + radius_mm, local[..., 2]
    before_end = np.mod(np.arctan2(-along, across), 2 * np.pi)
    beside = np.hypot(local[..., 0], np.hypot(along, across) - radius_mm)
    from_frames = np.sqrt(np.einsum("...i,...i", offsets, offsets))
    from_start, from_end = from_frames[..., :-1, :], from_frames[..., 1:, :]
    is_beside, is_at_end = before_end <= angles, from_end < from_start
    apart = np.where(is_beside, beside, np.where(is_at_end, from_end, from_start))
    return apart, np.where(is_beside, before_end, np.where(is_at_end, 0.0, angles))


def path_distances(
    psi: FloatArray, radius_mm: float, centres_mm: FloatArray, frames: ArcFrames | None = None
) -> FloatArray:
    """Return the distance from each path to each point, (..., K); arguments as `arc_distances`."""
    return np.asarray(arc_distances(psi, radius_mm, centres_mm, frames).min(axis=-2))


def find_nearest_places(
    psi: FloatArray, radius_mm: float, centres_mm: FloatArray, frames: ArcFrames
) -> NearestPlaces:
    """Return the nearest place of each path (M, n, 2) to each point (K, 3); arguments as `arc_distances`."""
    apart, before_end = _measure_arcs(psi, radius_mm, centres_mm, frames)
    least = apart.min(axis=-2)
    # Where two arcs meet, both are equally near: the first counts.
    arcs = (apart <= least[:, None] + _ROUNDING_MM).argmax(axis=-2)
    paths, points = np.ogrid[: arcs.shape[0], : arcs.shape[1]]
    angle = before_end[paths, arcs, points]
    on_arc = radius_mm * np.stack((np.zeros_like(angle), np.cos(angle) - 1.0, -np.sin(angle)), axis=-1)
    turned = (frames.rotations[paths, arcs + 1] @ on_arc[..., None])[..., 0]
    return NearestPlaces(least, frames.positions_mm[paths, arcs + 1] + turned, arcs)
