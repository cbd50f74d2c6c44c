"""Exact distances from paths of arcs to the centres of spheres, without sampling.

In the plane of an arc, the nearest point to a sphere's centre lies on the ray from the arc's centre to it if that ray
meets the arc. Otherwise it is an end of the arc.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labrig.needle.kinematics import ArcFrames, FloatArray, are_planar, path_frames, rotation_z

_ROUNDING_MM = 1e-9


@dataclass(frozen=True, eq=False)
class NearestPlaces:
    """The place on each of M paths that is nearest to each of K points.

    distances_mm : (M, K); places_mm : (M, K, 3) in {1b}; arcs : (M, K), the arc of each place.
    """

    distances_mm: FloatArray
    places_mm: FloatArray
    arcs: NDArray[np.intp]


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
    frames = frames or path_frames(psi, radius_mm)
    return _measure_arcs(psi, radius_mm, centres_mm, frames, _find_bending(psi, frames))


def _find_bending(psi: FloatArray, frames: ArcFrames) -> FloatArray:
    """Return the rotation at the start of each arc with its roll, (..., n, 3, 3): each bends in its y-z plane."""
    before = frames.rotations[..., :-1, :, :]
    if are_planar(psi):
        side = np.rint(np.cos(psi[..., 1]))
        return np.asarray(before * np.stack((side, side, np.ones_like(side)), axis=-1)[..., None, :])
    return np.asarray(before @ rotation_z(psi[..., 1]))


def _measure_arcs(
    psi: FloatArray, radius_mm: float, centres_mm: FloatArray, frames: ArcFrames, bending: FloatArray
) -> FloatArray:
    offsets = centres_mm - frames.positions_mm[..., None, :]  # (..., n + 1, K, 3)
    local = offsets[..., :-1, :, :] @ bending
    out, across, along = local[..., 0], local[..., 1] + radius_mm, local[..., 2]
    turned = np.mod(np.arctan2(along, across), 2 * np.pi)
    beside = np.hypot(out, np.hypot(along, across) - radius_mm)
    from_frames = np.linalg.norm(offsets, axis=-1)
    from_ends = np.minimum(from_frames[..., :-1, :], from_frames[..., 1:, :])
    return np.asarray(np.where(turned <= psi[..., 0, None], beside, from_ends))


def path_distances(
    psi: FloatArray, radius_mm: float, centres_mm: FloatArray, frames: ArcFrames | None = None
) -> FloatArray:
    """Return the distance from each path to each point, (..., K); arguments as `arc_distances`."""
    return np.asarray(arc_distances(psi, radius_mm, centres_mm, frames).min(axis=-2))


def find_nearest_places(
    psi: FloatArray, radius_mm: float, centres_mm: FloatArray, frames: ArcFrames
) -> NearestPlaces:
    """Return the nearest place of each path (M, n, 2) to each point (K, 3); arguments as `arc_distances`."""
    of_arcs = _find_bending(psi, frames)
    apart = _measure_arcs(psi, radius_mm, centres_mm, frames, of_arcs)
    # Where two arcs meet, both are equally near: the first counts.
    arcs = (apart <= apart.min(axis=-2, keepdims=True) + _ROUNDING_MM).argmax(axis=-2)
    paths = np.arange(len(psi))[:, None]
    bending = of_arcs[paths, arcs]
    starts, ends = frames.positions_mm[paths, arcs], frames.positions_mm[paths, arcs + 1]
    offsets = centres_mm - starts
    local = (offsets[..., None, :] @ bending)[..., 0, :]
    turned = np.mod(np.arctan2(local[..., 2], local[..., 1] + radius_mm), 2 * np.pi)
    angle = psi[paths, arcs, 0]
    nearer_end = np.linalg.norm(centres_mm - ends, axis=-1) < np.linalg.norm(offsets, axis=-1)
    at = np.where(turned <= angle, turned, np.where(nearer_end, angle, 0.0))
    on_arc = radius_mm * np.stack((np.zeros_like(at), np.cos(at) - 1.0, np.sin(at)), axis=-1)
    places = starts + (bending @ on_arc[..., None])[..., 0]
    return NearestPlaces(apart.min(axis=-2), places, arcs)
