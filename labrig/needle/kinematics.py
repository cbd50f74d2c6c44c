"""Paths of circular arcs: equations (4) to (10), (12) and (15) of the paper, for any number of paths at once.

A path is its configuration psi, an array (..., n, 2) with columns (theta_i, delta_i): the angle of the i-th arc
[rad], which is its length over the radius (equation 4), and the roll before it [rad], relative to {ib}.
Leading axes are paths. Unless stated otherwise, positions are in {1b}, the frame at the start of the path.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]

# A sine of a roll below counts as that of half turns.
_HALF_TURNS = 1e-12


@dataclass(frozen=True)
class ArcFrames:
    """The frames {1b}, {2b}, ... {nb}, {ne} of a path in {1b}; {ie} is {(i+1)b}.

    Parameters
    ----------
    positions_mm : (..., n + 1, 3) array
    rotations : (..., n + 1, 3, 3) array
    """

    positions_mm: FloatArray
    rotations: FloatArray

    def take(self, which: NDArray[np.intp]) -> "ArcFrames":
        """Return the frames of a selection of paths."""
        return ArcFrames(self.positions_mm[which], self.rotations[which])


def rotation_x(angle_rad: ArrayLike) -> FloatArray:
    """Return exp(angle e_1^), (..., 3, 3)."""
    cosine, sine = np.cos(angle_rad), np.sin(angle_rad)
    turned = np.zeros((*cosine.shape, 3, 3))
    turned[..., 0, 0] = 1.0
    turned[..., 1, 1], turned[..., 1, 2] = cosine, -sine
    turned[..., 2, 1], turned[..., 2, 2] = sine, cosine
    return turned


def rotation_z(angle_rad: ArrayLike) -> FloatArray:
    """Return exp(angle e_3^), (..., 3, 3)."""
    cosine, sine = np.cos(angle_rad), np.sin(angle_rad)
    turned = np.zeros((*cosine.shape, 3, 3))
    turned[..., 0, 0], turned[..., 0, 1] = cosine, -sine
    turned[..., 1, 0], turned[..., 1, 1] = sine, cosine
    turned[..., 2, 2] = 1.0
    return turned


def cross_matrix(vector: ArrayLike) -> FloatArray:
    """Return v^, (..., 3, 3), so that `v^ @ w` is the cross product of v and w."""
    v = np.asarray(vector, dtype=float)
    matrix = np.zeros((*v.shape, 3))
    matrix[..., 0, 1], matrix[..., 0, 2] = -v[..., 2], v[..., 1]
    matrix[..., 1, 0], matrix[..., 1, 2] = v[..., 2], -v[..., 0]
    matrix[..., 2, 0], matrix[..., 2, 1] = -v[..., 1], v[..., 0]
    return matrix


def arc_pose(angle_rad: ArrayLike, roll_rad: ArrayLike, radius_mm: float) -> tuple[FloatArray, FloatArray]:
    """Return position (..., 3) and rotation (..., 3, 3) of {ie} in {ib}, equations (5) and (6)."""
    return _arc_points(angle_rad, roll_rad, radius_mm), rotation_z(roll_rad) @ rotation_x(angle_rad)


def path_frames(psi: FloatArray, radius_mm: float) -> ArcFrames:
    """Return the frames along paths, equations (7) and (8).

    Parameters
    ----------
    psi : (..., n, 2) array
        Columns (theta, delta) [rad].
    radius_mm : float
        Radius of every arc.
    """
    arcs = psi.shape[-2]
    if (np.abs(np.sin(psi[..., 1])) < _HALF_TURNS).all():
        return _planar_frames(psi, radius_mm)
    steps, turns = arc_pose(psi[..., 0], psi[..., 1], radius_mm)
    positions = np.zeros((*psi.shape[:-2], arcs + 1, 3))
    rotations = np.zeros((*psi.shape[:-2], arcs + 1, 3, 3))
    rotations[..., 0, :, :] = np.eye(3)
    for i in range(arcs):
        base = rotations[..., i, :, :]
        positions[..., i + 1, :] = positions[..., i, :] + (base @ steps[..., i, :, None])[..., 0]
        rotations[..., i + 1, :, :] = base @ turns[..., i, :, :]
    return ArcFrames(positions, rotations)


def _planar_frames(psi: FloatArray, radius_mm: float) -> ArcFrames:
    """Return the frames along paths of half turns, which stay in the y-z plane: by headings, for all arcs at once.

    A frame is exp(phi e_1^) diag(s, s, 1) with s = +-1, and an arc bends the heading phi by s theta.
    """
    *paths, arcs, _ = psi.shape
    sides = np.ones((*paths, arcs + 1))
    np.cumprod(np.rint(np.cos(psi[..., 1])), axis=-1, out=sides[..., 1:])
    headings = np.zeros((*paths, arcs + 1))
    np.cumsum(sides[..., 1:] * psi[..., 0], axis=-1, out=headings[..., 1:])
    cosine, sine, arms = np.cos(headings), np.sin(headings), radius_mm * sides[..., 1:]
    positions = np.zeros((*paths, arcs + 1, 3))
    np.cumsum(arms * (cosine[..., 1:] - cosine[..., :-1]), axis=-1, out=positions[..., 1:, 1])
    np.cumsum(arms * (sine[..., 1:] - sine[..., :-1]), axis=-1, out=positions[..., 1:, 2])
    rotations = np.zeros((*paths, arcs + 1, 3, 3))
    rotations[..., 0, 0] = sides
    rotations[..., 1, 1], rotations[..., 1, 2] = sides * cosine, -sine
    rotations[..., 2, 1], rotations[..., 2, 2] = sides * sine, cosine
    return ArcFrames(positions, rotations)


def path_jacobian(radius_mm: float, frames: ArcFrames) -> FloatArray:
    """Return J_v, (..., 3, 2n), the derivative of the tip of paths in {1b} by psi_1, ... psi_n, equation (10)."""
    tips = frames.positions_mm[..., -1:, :]
    last = np.full(tips.shape[:-1], frames.positions_mm.shape[-2] - 2)
    return place_jacobians(radius_mm, frames, tips, last, 1.0)[..., 0, :, :]


def place_jacobians(
    radius_mm: float, frames: ArcFrames, places: FloatArray, arcs: NDArray[np.intp], shares: ArrayLike
) -> FloatArray:
    """Return the derivatives by psi of places (..., q, 3) on arcs (..., q) of paths, (..., q, 3, 2n), equation (15).

    A change of theta_k turns what is beyond about the centre of the arc k, and one of delta_k about the needle's axis
    at the arc's start: this is Lambda_k of (10) and (15), and the frames have these axes and centres. As printed, the
    block of a place's own arc takes J_v at theta_i; here it is that of the place, and its theta column times the share
    (q,) of the change by which the place's angle on the arc changes (errata, equation 15): j / m for a control point,
    1 for the tip, 0 for a place that keeps its angle.
    """
    turned = frames.rotations[..., 1:, :, :]
    centres = frames.positions_mm[..., 1:, :] - radius_mm * turned[..., 1]
    pivots = np.stack((centres, frames.positions_mm[..., :-1, :]), axis=-2)
    axes = np.stack((turned[..., 0], frames.rotations[..., :-1, :, 2]), axis=-2)
    moved = (pivots[..., None, :] - places[..., None, None, :, :]) @ cross_matrix(axes)  # (..., n, 2, q, 3)
    numbers, own = np.arange(moved.shape[-4])[:, None], arcs[..., None, :]
    moved *= np.stack((np.where(own == numbers, shares, own > numbers), own >= numbers), axis=-2)[..., None]
    return np.swapaxes(np.swapaxes(moved.reshape(*moved.shape[:-4], -1, *moved.shape[-2:]), -3, -2), -2, -1)


def path_points(psi: FloatArray, radius_mm: float, fractions: FloatArray) -> FloatArray:
    """Return (..., n, m, 3) points at these fractions (m,) of every arc."""
    frames = path_frames(psi, radius_mm)
    angles = psi[..., 0, None] * fractions
    local = _arc_points(angles, np.broadcast_to(psi[..., 1, None], angles.shape), radius_mm)
    turned = np.einsum("...iab,...ijb->...ija", frames.rotations[..., :-1, :, :], local)
    return np.asarray(turned + frames.positions_mm[..., :-1, None, :])


def control_points(psi: FloatArray, radius_mm: float, points: int) -> FloatArray:
    """Return p_a_ij, (..., n, m, 3): m points evenly spread on each arc, its end included, equation (12)."""
    return path_points(psi, radius_mm, _fractions(points))


def control_jacobians(psi: FloatArray, radius_mm: float, points: int) -> FloatArray:
    """Return J_a_ij, (..., n, m, 3, 2n), the derivative of each control point by psi, equation (15)."""
    arcs = np.repeat(np.arange(psi.shape[-2]), points)
    shares = np.tile(_fractions(points), psi.shape[-2])
    places = control_points(psi, radius_mm, points)
    flat = places.reshape(*psi.shape[:-2], len(arcs), 3)
    on = np.broadcast_to(arcs, flat.shape[:-1])
    found = place_jacobians(radius_mm, path_frames(psi, radius_mm), flat, on, shares)
    return found.reshape(*places.shape, found.shape[-1])


def _fractions(points: int) -> FloatArray:
    return np.arange(1, points + 1) / points


def _arc_points(angle_rad: ArrayLike, roll_rad: ArrayLike, radius_mm: float) -> FloatArray:
    """Return equation (5), (..., 3); 1 - cos is written with the half angle, so that tiny arcs keep their digits."""
    theta, delta = np.asarray(angle_rad, float), np.asarray(roll_rad, float)
    versine = 2.0 * np.sin(theta / 2.0) ** 2
    across = np.sin(delta) * versine
    points = np.empty((*across.shape, 3))
    points[..., 0], points[..., 1], points[..., 2] = across, -np.cos(delta) * versine, np.sin(theta)
    return radius_mm * points
