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
# For fewer paths the way by the plane takes longer than that in space.
_MANY = 16
_UNIT = np.eye(3)


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
    if are_planar(psi):
        return _planar_frames(psi, radius_mm)
    steps, turns = arc_pose(psi[..., 0], psi[..., 1], radius_mm)
    positions = np.zeros((*psi.shape[:-2], arcs + 1, 3))
    rotations = np.zeros((*psi.shape[:-2], arcs + 1, 3, 3))
    rotations[..., 0, :, :] = _UNIT
    for i in range(arcs):
        base = rotations[..., i, :, :]
        positions[..., i + 1, :] = positions[..., i, :] + _apply(base, steps[..., i, :])
        rotations[..., i + 1, :, :] = base @ turns[..., i, :, :]
    return ArcFrames(positions, rotations)


def are_planar(psi: FloatArray) -> bool:
    """Return whether these are many paths (M, n, 2) whose rolls are whole half turns, so that they stay in a plane."""
    return len(psi) > _MANY and bool(np.all(np.abs(np.sin(psi[..., 1])) < _HALF_TURNS))


def _planar_frames(psi: FloatArray, radius_mm: float) -> ArcFrames:
    """Return the frames along paths of half turns: by headings in the y-z plane, for all arcs at once.

    A frame is exp(phi e_1^) diag(s, s, 1) with s = +-1, and an arc bends the heading phi by s theta.
    """
    sides = np.cumprod(np.rint(np.cos(psi[..., 1])), axis=-1)
    headings = np.zeros((*psi.shape[:-2], psi.shape[-2] + 1))
    np.cumsum(sides * psi[..., 0], axis=-1, out=headings[..., 1:])
    cosine, sine = np.cos(headings), np.sin(headings)
    positions = np.zeros((*headings.shape, 3))
    arms = radius_mm * sides
    np.cumsum(arms * np.diff(cosine, axis=-1), axis=-1, out=positions[..., 1:, 1])
    np.cumsum(arms * np.diff(sine, axis=-1), axis=-1, out=positions[..., 1:, 2])
    side = np.concatenate((np.ones((*sides.shape[:-1], 1)), sides), axis=-1)
    rotations = np.zeros((*headings.shape, 3, 3))
    rotations[..., 0, 0] = side
    rotations[..., 1, 1], rotations[..., 1, 2] = side * cosine, -sine
    rotations[..., 2, 1], rotations[..., 2, 2] = side * sine, cosine
    return ArcFrames(positions, rotations)


def arc_jacobian(angle_rad: ArrayLike, roll_rad: ArrayLike, radius_mm: float) -> FloatArray:
    """Return J_vi, (..., 3, 2), the derivative of the arc's tip in {ib} by theta and delta, equation (9)."""
    theta, delta = np.asarray(angle_rad, float), np.asarray(roll_rad, float)
    versine = 2.0 * np.sin(theta / 2.0) ** 2
    sine, cosine, along = np.sin(delta), np.cos(delta), np.sin(theta)
    across = sine * along
    jacobian = np.zeros((*across.shape, 3, 2))
    jacobian[..., 0, 0], jacobian[..., 0, 1] = across, cosine * versine
    jacobian[..., 1, 0], jacobian[..., 1, 1] = -cosine * along, sine * versine
    jacobian[..., 2, 0] = np.cos(theta)
    return radius_mm * jacobian


def path_jacobian(psi: FloatArray, radius_mm: float, frames: ArcFrames | None = None) -> FloatArray:
    """Return J_v, (..., 3, 2n), the derivative of the path's tip in {1b} by psi_1, ... psi_n, equation (10).

    `frames` are those of the paths, if they are known already.
    """
    frames = frames or path_frames(psi, radius_mm)
    blocks = _arc_blocks(psi, radius_mm, frames, frames.positions_mm[..., None, -1, :])[..., 0, :, :, :]
    return _side_by_side(blocks)


def tip_and_place_jacobians(
    psi: FloatArray, radius_mm: float, frames: ArcFrames, places: FloatArray, arcs: NDArray[np.intp]
) -> tuple[FloatArray, FloatArray]:
    """Return the derivatives by psi of the path's tip (..., 3, 2n) and of places (..., q, 3) on arcs (..., q).

    That of the tip is `path_jacobian`. That of the places is (..., q, 3, 2n): a place keeps its angle on its own arc,
    so that the arc's theta does not move it (equation 15 without its f).
    """
    tips = frames.positions_mm[..., None, -1, :]
    blocks = _arc_blocks(psi, radius_mm, frames, np.concatenate((tips, places), axis=-2))
    return _side_by_side(blocks[..., 0, :, :, :]), _hold_on_arcs(blocks[..., 1:, :, :, :], arcs)


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
    """Return J_a_ij, (..., n, m, 3, 2n), the derivative of each control point by psi, equation (15).

    As printed, the block of the point's own arc (k = i) takes J_v at theta_i; the point lies at f theta_i,
    f = j / m, so the block is J_v(f theta_i) with its theta column times f (errata, equation 15).
    """
    arcs = psi.shape[-2]
    fractions = _fractions(points)
    frames = path_frames(psi, radius_mm)
    places = control_points(psi, radius_mm, points)
    jacobians = np.zeros((*psi.shape[:-2], arcs, points, 3, 2 * arcs))
    for i in range(arcs):
        blocks = _arc_blocks(psi, radius_mm, frames, places[..., i, :, :])
        own = arc_jacobian(psi[..., i, 0, None] * fractions, psi[..., i, 1, None], radius_mm)
        own[..., 0] *= fractions[:, None]
        blocks[..., i, :, :] = frames.rotations[..., None, i, :, :] @ own
        blocks[..., i + 1 :, :, :] = 0.0
        jacobians[..., i, :, :, :] = _side_by_side(blocks)
    return jacobians


def _hold_on_arcs(blocks: FloatArray, arcs: NDArray[np.intp]) -> FloatArray:
    """Return the derivatives of places on arcs, from the blocks (..., q, n, 3, 2) of places beyond every arc."""
    numbers = np.arange(blocks.shape[-3])
    blocks[arcs[..., None] < numbers] = 0.0
    blocks[..., 0] *= (arcs[..., None] > numbers)[..., None]
    return _side_by_side(blocks)


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


def _apply(rotations: FloatArray, vectors: FloatArray) -> FloatArray:
    return np.asarray((rotations @ vectors[..., None])[..., 0])


def _arc_blocks(psi: FloatArray, radius_mm: float, frames: ArcFrames, places: FloatArray) -> FloatArray:
    """Return Lambda_k of equations (10) and (15), (..., q, n, 3, 2), for places (..., q, 3) beyond every arc k.

    -(R v)^ J_omega is J_omega x (R v), and a rotation can be moved out of a cross product: so the block is
    R_kb J_vk + (R_kb J_omega_k) x (p - p_ke), with all vectors in {1b}.
    """
    bases = frames.rotations[..., :-1, :, :]
    translation = bases @ arc_jacobian(psi[..., 0], psi[..., 1], radius_mm)
    rotation = bases @ _angular_jacobian(psi[..., 1])
    lever = places[..., :, None, :] - frames.positions_mm[..., None, 1:, :]
    return np.asarray(translation[..., None, :, :, :] - cross_matrix(lever) @ rotation[..., None, :, :, :])


def _angular_jacobian(roll_rad: FloatArray) -> FloatArray:
    """Return J_omega_i, (..., 3, 2), of equation (10)."""
    jacobian = np.zeros((*roll_rad.shape, 3, 2))
    jacobian[..., 0, 0], jacobian[..., 1, 0] = np.cos(roll_rad), np.sin(roll_rad)
    jacobian[..., 2, 1] = 1.0
    return jacobian


def _side_by_side(blocks: FloatArray) -> FloatArray:
    """Turn (..., n, 3, 2) blocks into (..., 3, 2n)."""
    turned = np.moveaxis(blocks, -3, -2)
    return turned.reshape(*turned.shape[:-2], 2 * blocks.shape[-3])
