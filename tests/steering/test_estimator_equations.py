"""The equations of the estimator against central differences, matrix exponentials and the room below."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from labrig.needle.kinematics import arc_pose, cross_matrix
from labrig.steering.motion import (
    rotation_from_vector,
    step_frame,
    step_origin_slope,
    vector_from_rotation,
)
from labrig.steering.paper_filter import body_rates, euler_angles, position_jacobian, rotation_from_euler

ANGLES = st.tuples(st.floats(-3.1, 3.1), st.floats(-1.5, 1.5), st.floats(-3.1, 3.1)).map(np.array)
STEP = 1e-6


@given(roll_rad=st.floats(-4.0, 4.0), step_mm=st.floats(0.0, 30.0), radius_mm=st.floats(1.0, 1e4))
def test_a_step_is_an_arc(roll_rad: float, step_mm: float, radius_mm: float) -> None:
    """Equations (16) and (17) by curvature are (5) and (6) by radius."""
    rotation, origin_mm = step_frame(roll_rad, step_mm, 1.0 / radius_mm)
    position_mm, turned = arc_pose(step_mm / radius_mm, roll_rad, radius_mm)
    np.testing.assert_allclose(origin_mm, position_mm, atol=1e-10)
    np.testing.assert_allclose(rotation, turned, atol=1e-12)


def test_a_straight_step_goes_straight() -> None:
    """Without curvature the step is along z."""
    np.testing.assert_array_equal(step_frame(0.0, 3.0, 0.0)[1], (0.0, 0.0, 3.0))


@pytest.mark.parametrize("roll_rad", [0.0, 2.2])
@pytest.mark.parametrize("curvature", [-0.04, -1e-9, 0.0, 1e-7, 0.00333, 0.0034, 0.036, 0.2])
def test_the_slope_is_the_derivative(curvature: float, roll_rad: float) -> None:
    """How a step of 3 mm changes with the curvature, also at zero and on both sides of the series' end."""
    ahead_mm, behind_mm = (step_frame(roll_rad, 3.0, curvature + s * 1e-4)[1] for s in (1.0, -1.0))
    slope = step_origin_slope(roll_rad, 3.0, curvature)
    np.testing.assert_allclose(slope, (ahead_mm - behind_mm) / 2e-4, atol=1e-6)


@pytest.mark.processors
@given(vector=st.tuples(*[st.floats(-4.0, 4.0)] * 3).map(np.array))
def test_turned_is_the_matrix_exponential(vector: np.ndarray) -> None:
    """Rodrigues' formula at every size of angle, zero included."""
    np.testing.assert_allclose(rotation_from_vector(vector), expm(cross_matrix(vector)), atol=1e-12)


@given(angles=ANGLES)
def test_euler_angles_come_back(angles: np.ndarray) -> None:
    """The angles of a rotation made of angles are these angles, away from the lock."""
    np.testing.assert_allclose(euler_angles(rotation_from_euler(angles)), angles, atol=1e-9)


def test_a_rotation_is_the_product_of_three() -> None:
    """R is e^(z) e^(y) e^(x), equation (16)."""
    angles = np.array((0.4, -0.9, 2.1))
    x, y, z = (expm(a * cross_matrix(axis)) for a, axis in zip(angles, np.eye(3), strict=True))
    np.testing.assert_allclose(rotation_from_euler(angles), z @ y @ x, atol=1e-14)


@given(angles=ANGLES)
def test_the_corrected_jacobian_is_the_derivative(angles: np.ndarray) -> None:
    """Equation (25) with e_3^T R_y R_x agrees with central differences; with e_3^T R_y it is off by up to 0.25."""
    _, advance = step_frame(0.0, 1.0, 1.0 / 27.6)
    differences = [
        (rotation_from_euler(angles + STEP * axis) - rotation_from_euler(angles - STEP * axis))
        @ advance
        / (2.0 * STEP)
        for axis in np.eye(3)
    ]
    np.testing.assert_allclose(position_jacobian(angles, advance), np.transpose(differences), atol=1e-7)


@given(angles=ANGLES)
def test_body_rates_turn_the_tip(angles: np.ndarray) -> None:
    """A small change of the angles turns the tip's frame by the body rates."""
    for axis, rate in zip(np.eye(3), body_rates(angles).T, strict=True):
        change = rotation_from_euler(angles).T @ (
            rotation_from_euler(angles + STEP * axis) - rotation_from_euler(angles - STEP * axis)
        )
        np.testing.assert_allclose(change / (2.0 * STEP), cross_matrix(rate), atol=1e-7)


@pytest.mark.processors
def test_a_rotation_vector_is_scipys() -> None:
    """Small and large turns, in the plane and in space, about any axis; the last digits are those of the C library."""
    random = np.random.default_rng(0)
    for size_rad in np.geomspace(1e-9, 3.1, 200):
        axis = random.standard_normal(3)
        for vector in (size_rad * axis / np.linalg.norm(axis), np.array((size_rad, 0.0, 0.0))):
            rotation = rotation_from_vector(vector)
            expected = Rotation.from_matrix(rotation).as_rotvec()
            np.testing.assert_allclose(vector_from_rotation(rotation), expected, rtol=1e-14, atol=1e-22)
