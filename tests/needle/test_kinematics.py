"""Laws of the kinematics of arcs, at zero, tiny and random configurations."""

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from labrig.needle.kinematics import (
    arc_pose,
    control_jacobians,
    control_points,
    path_frames,
    path_jacobian,
    path_points,
    place_jacobians,
)

FloatArray = NDArray[np.float64]
RADIUS_MM = 27.6
POINTS = 5
ZERO = np.zeros((4, 2))
TINY = 1e-9 * np.array([[1.0, 2.0], [3.0, -1.0], [0.5, 0.0], [2.0, 1.0]])


def _random(arcs: int, seed: int) -> FloatArray:
    rng = np.random.default_rng(seed)
    return np.column_stack((rng.uniform(-0.3, 1.6, arcs), rng.uniform(-np.pi, np.pi, arcs)))


CONFIGURATIONS = [ZERO, TINY, *(_random(arcs, seed) for seed, arcs in enumerate((1, 2, 3, 4, 5, 6)))]


def _integrate(psi: FloatArray, steps: int = 400) -> FloatArray:
    """Return the tip by following curvature and roll in small steps, with none of the closed forms."""
    position, rotation = np.zeros(3), Rotation.identity()
    for theta, delta in psi:
        rotation = rotation * Rotation.from_rotvec([0.0, 0.0, delta])
        half, whole = (Rotation.from_rotvec([theta / steps / part, 0, 0]) for part in (2, 1))
        for _ in range(steps):
            position = position + RADIUS_MM * theta / steps * (rotation * half).apply([0.0, 0.0, 1.0])
            rotation = rotation * whole
    return position


def _differences(tip: Callable[[FloatArray], FloatArray], psi: FloatArray, step: float = 1e-4) -> FloatArray:
    """Return fourth-order central differences of a function of psi, the 2n variables last."""
    columns = []
    for k in range(psi.size):
        flat = np.zeros(psi.size)
        flat[k] = step
        nudge = flat.reshape(psi.shape)
        near = tip(psi + nudge) - tip(psi - nudge)
        columns.append((8 * near - (tip(psi + 2 * nudge) - tip(psi - 2 * nudge))) / (12 * step))
    return np.stack(columns, axis=-1)


@pytest.mark.processors
@pytest.mark.parametrize("psi", CONFIGURATIONS)
def test_the_tip_is_where_integration_ends(psi: FloatArray) -> None:
    """Equations (5) to (8) agree with stepwise integration of curvature and roll; control points end at {ie}."""
    frames = path_frames(psi, RADIUS_MM)
    np.testing.assert_allclose(frames.positions_mm[-1], _integrate(psi), atol=1e-4)
    ends = control_points(psi, RADIUS_MM, POINTS)[:, -1]
    np.testing.assert_allclose(ends, frames.positions_mm[1:], atol=1e-12)
    starts = path_points(psi, RADIUS_MM, np.zeros(1))[:, 0]
    np.testing.assert_allclose(starts, frames.positions_mm[:-1], atol=1e-12)


@pytest.mark.parametrize("psi", CONFIGURATIONS)
def test_the_jacobians_are_derivatives(psi: FloatArray) -> None:
    """Equations (10) and (15), its own-arc block corrected, and places that keep their angle: to 1e-7."""

    def places(moved: FloatArray) -> FloatArray:
        frames = path_frames(moved, RADIUS_MM)
        steps, _ = arc_pose(psi[:, 0] / 2, moved[:, 1], RADIUS_MM)
        return frames.positions_mm[:-1] + (frames.rotations[:-1] @ steps[..., None])[..., 0]

    frames, own = path_frames(psi, RADIUS_MM), np.arange(len(psi))
    for found, moving in (
        (path_jacobian(RADIUS_MM, frames), lambda p: path_frames(p, RADIUS_MM).positions_mm[-1]),
        (control_jacobians(psi, RADIUS_MM, POINTS), lambda p: control_points(p, RADIUS_MM, POINTS)),
        (place_jacobians(RADIUS_MM, frames, places(psi), own, 0.0), places),
    ):
        np.testing.assert_allclose(found, _differences(moving, psi), atol=1e-7)


def test_an_arc_bends_towards_minus_y_and_keeps_its_digits() -> None:
    """delta = 0 bends towards -y, pi towards +y, in the plane; a nanoradian deflects by r theta squared over two."""
    for roll_rad, side in ((0.0, -1), (np.pi, 1)):
        position, _ = arc_pose(np.pi / 2, roll_rad, RADIUS_MM)
        np.testing.assert_allclose(position, [0.0, side * RADIUS_MM, RADIUS_MM], atol=1e-12)
    position, _ = arc_pose(1e-9, 0.0, RADIUS_MM)
    assert position[1] == pytest.approx(-RADIUS_MM * 0.5e-18, rel=1e-12)


@given(st.integers(0, 2**32 - 1), st.integers(1, 6))
def test_frames_are_rotations_on_the_arcs(seed: int, arcs: int) -> None:
    """Frames stay right-handed and orthonormal, and chords are 2 r sin(theta / 2)."""
    psi = _random(arcs, seed)
    frames = path_frames(psi, RADIUS_MM)
    turned = frames.rotations @ np.swapaxes(frames.rotations, -1, -2)
    np.testing.assert_allclose(turned, np.broadcast_to(np.eye(3), turned.shape), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(frames.rotations), 1.0)
    chords = np.linalg.norm(np.diff(frames.positions_mm, axis=0), axis=1)
    np.testing.assert_allclose(chords, 2 * RADIUS_MM * np.abs(np.sin(psi[:, 0] / 2)), atol=1e-10)


@given(st.integers(0, 2**32 - 1))
def test_many_paths_at_once_are_each_path_alone(seed: int) -> None:
    """Leading axes change nothing: a stack of paths gives the stack of results."""
    stack = np.stack([_random(3, seed), _random(3, seed + 1)])
    of_tips = path_jacobian(RADIUS_MM, path_frames(stack, RADIUS_MM))
    for k, psi in enumerate(stack):
        alone = path_jacobian(RADIUS_MM, path_frames(psi, RADIUS_MM))
        np.testing.assert_allclose(of_tips[k], alone, atol=1e-12)
        both = control_jacobians(stack, RADIUS_MM, POINTS)[k]
        np.testing.assert_allclose(both, control_jacobians(psi, RADIUS_MM, POINTS), atol=1e-12)
