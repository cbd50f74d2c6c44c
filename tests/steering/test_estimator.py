"""The tip estimator with clean, noisy, missing and wild observations, and its equations against the room below."""

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from labrig.errors import InputError
from labrig.needle.kinematics import arc_pose, cross_matrix
from labrig.steering.estimator import estimate_tip_poses, start_tip, step_tip
from labrig.steering.motion import rotation_from_vector, step_frame, step_origin_slope, vector_from_rotation
from labrig.steering.paper_filter import body_rates, euler_angles, position_jacobian, rotation_from_euler
from labrig.steering.tip import TipObservation
from tests.steering.insertions import (
    PROCESS_SD_RAD,
    RADIUS_MM,
    SIGMA_MM,
    follow,
    heading_errors_rad,
    heading_rmse_deg,
    insert,
    mean_nees_in_band,
    settings,
)
from tests.steering.plain_ekf import bound_heading_rad2, plain_ekf

PLANES = pytest.mark.parametrize("planar", [True, False], ids=["planar", "spatial"])
METHODS = pytest.mark.parametrize("method", ["error-state", "paper"])
RADIUS_SD_MM = 0.02 * RADIUS_MM


@cache
def follow_drawn(seed, planar, **changes):
    """Return the states of the insertion of a seed."""
    return follow(insert(seed, planar), settings(planar, **changes))


def poses_of(insertion, planar, **changes):
    """Return the poses of a whole insertion, step by step, (T + 1, 4, 4)."""
    return np.stack([state.pose for state in follow(insertion, settings(planar, **changes))])


def estimate(insertion, **changes):
    """Estimate a whole insertion, with the noise of the simulated world unless told otherwise."""
    known = {"radius_mm": RADIUS_MM, "observation_sd_mm": SIGMA_MM, "process_sd_rad": PROCESS_SD_RAD}
    seen = {"positions_mm": insertion.positions_mm, "step_mm": 1.0, "roll_rad": insertion.roll_rad}
    return estimate_tip_poses(**(seen | known | changes))


@pytest.mark.processors
@PLANES
@METHODS
@pytest.mark.parametrize("radius_mm", [5.0, 27.6, 300.0])
def test_clean_observations_give_the_true_poses(method, planar, radius_mm):
    """Without noise the model's own path is followed exactly, flips and headings beyond 90 degrees included."""
    insertion = insert(3, planar, radius_mm, noise=0.0)
    poses = poses_of(insertion, planar, radius_mm=radius_mm, method=method)
    assert poses.shape == (101, 4, 4)
    np.testing.assert_allclose(poses, insertion.truth, atol=1e-9)


@METHODS
@given(seed=st.integers(0, 1000), vector=st.tuples(*[st.floats(-1.0, 1.0)] * 3), shift=st.floats(-50.0, 50.0))
@hypothesis_settings(max_examples=8, deadline=None)
def test_every_pose_is_rigid_and_moves_with_the_world(method, seed, vector, shift):
    """Poses stay rigid, and the default filter's turn with the world: they do not know where its axes point."""
    insertion = insert(seed, planar=False)
    world, start = np.eye(4), np.eye(4)
    world[:3, :3], world[:3, 3] = Rotation.from_rotvec(vector).as_matrix(), shift
    start[:3, 3] = insertion.positions_mm[0]
    poses = estimate(insertion, start=start, method=method)
    rotations = poses[:, :3, :3]
    np.testing.assert_allclose(rotations.transpose(0, 2, 1) @ rotations - np.eye(3), 0.0, atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(rotations), 1.0, atol=1e-12)
    if method == "error-state":
        seen = insertion.positions_mm @ world[:3, :3].T + shift
        turned = estimate(insertion, positions_mm=seen, start=world @ start)
        np.testing.assert_allclose(turned, world @ poses, atol=1e-9)


@METHODS
def test_the_batch_is_the_live_steps(method):
    """`estimate_tip_poses` and a chain of `step_tip` give the same poses, bit for bit."""
    insertion = insert(11, planar=False)
    np.testing.assert_array_equal(
        estimate(insertion, method=method), poses_of(insertion, planar=False, method=method)
    )


@METHODS
def test_in_the_plane_the_needle_stays_in_the_plane(method):
    """Out of its plane the planar filter neither moves nor turns, whatever is seen there."""
    insertion = insert(5, planar=True)
    positions = insertion.positions_mm + np.outer(np.sin(np.arange(101.0)), (0.5, 0.0, 0.0))
    poses = poses_of(replace(insertion, positions_mm=positions), planar=True, method=method)
    np.testing.assert_allclose(np.abs(poses[:, 0, 0]), 1.0, atol=1e-12)
    if method == "error-state":
        np.testing.assert_allclose(poses[:, 0, 3], positions[0, 0], atol=1e-9)


@pytest.mark.processors
@PLANES
@pytest.mark.parametrize("radius_sd_mm", [0.0, RADIUS_SD_MM], ids=["known", "estimated"])
def test_the_default_filter_equals_a_plain_one(planar, radius_sd_mm):
    """An independent filter, its Jacobians by differences, gives the same poses, covariances, NIS and likelihoods."""
    poses, covariances, sightings = plain_ekf(insert(12, planar), planar, radius_sd_mm)
    states = follow_drawn(12, planar, radius_sd_mm=radius_sd_mm)
    np.testing.assert_allclose([s.pose for s in states], poses, atol=1e-7)
    np.testing.assert_allclose([s.covariance for s in states], covariances, atol=1e-9)
    np.testing.assert_allclose([(s.nis, s.log_likelihood) for s in states[1:]], sightings, atol=1e-6)


@PLANES
def test_the_covariance_tells_the_error(planar):
    """The mean NEES of 40 runs is within its 95 % band at four steps in five (the benchmark: 200 runs, nine in ten)."""
    share, mean = mean_nees_in_band(40, planar, RADIUS_SD_MM)
    assert share >= 0.8
    assert mean == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize(("planar", "limit"), [(True, 0.75), (False, 0.6)])
def test_the_default_beats_the_paper(planar, limit):
    """With the radius 2 % wrong the heading is that much better than the corrected paper filter's, over ten runs."""
    paper = heading_rmse_deg(10, settings(planar, method="paper"))
    assert heading_rmse_deg(10, settings(planar)) <= limit * paper


@PLANES
def test_no_filter_could_know_the_heading_much_better(planar):
    """The RMSE of the heading is that of the posterior Cramer-Rao bound, and the mean NIS the number of seen axes."""
    squares, bounds, nis = [], [], []
    for seed in range(20):
        states = follow_drawn(seed, planar)
        poses = np.stack([state.pose for state in states])
        squares.append(np.mean(heading_errors_rad(poses, insert(seed, planar).truth) ** 2))
        bounds.append(np.mean(bound_heading_rad2(seed, planar)))
        nis += [state.nis for state in states[1:]]
    assert math.sqrt(np.mean(squares) / np.mean(bounds)) == pytest.approx(1.0, abs=0.12)
    assert np.mean(nis) == pytest.approx(2 if planar else 3, rel=0.06)


def test_one_wild_observation_changes_nothing():
    """An observation 5 mm off is rejected, its NIS kept, and the next headings are as if the tip had been missed."""
    insertion, chosen = insert(4, planar=True), settings(planar=True)
    state = follow(insertion, chosen)[50]
    observation = insertion.observations[50]
    wild = TipObservation(observation.position_mm + np.array((0.0, 5.0, 0.0)), 1.0, observation.roll_rad)
    rejected = step_tip(state, wild, chosen)
    missed = step_tip(state, TipObservation(None, 1.0, observation.roll_rad), chosen)
    assert (rejected.accepted, rejected.misses, missed.nis) == (False, 1, None)
    assert rejected.nis > 100.0
    np.testing.assert_array_equal(rejected.pose, missed.pose)
    np.testing.assert_array_equal(rejected.covariance, missed.covariance)


def test_after_its_patience_the_filter_believes_what_it_sees():
    """After 10 mm of straight path, as in a cavity, the gate accepts observations again."""
    chosen = settings(planar=True)
    states = [start_tip(np.eye(4), chosen)]
    for t in range(1, 61):
        turned = max(t - 25, 0) / RADIUS_MM
        seen = np.array((0.0, RADIUS_MM * (np.cos(turned) - 1.0), RADIUS_MM * np.sin(turned) + min(t, 25)))
        states.append(step_tip(states[-1], TipObservation(seen, 1.0), chosen))
    assert any(not s.accepted for s in states)
    assert max(s.misses for s in states) <= 3
    assert states[-1].heading_rad == pytest.approx(-35.0 / RADIUS_MM, abs=0.05)


def test_a_missing_observation_widens_the_covariance():
    """Without observations the model moves the tip, and the covariance grows at every step."""
    chosen = settings(planar=False)
    states = follow(insert(1, planar=False), chosen)[:31]
    for _ in range(5):
        states.append(step_tip(states[-1], TipObservation(None, 1.0), chosen))
    lost = states[30:]
    assert [s.misses for s in lost] == [0, 1, 2, 3, 4, 5]
    assert all(np.diff([s.position_sd_mm for s in lost]) > 0.0)
    assert all(np.diff([s.heading_sd_rad for s in lost]) > 0.0)


@METHODS
def test_states_are_values(method):
    """A step gives the same answer twice, and nothing in a state can be written."""
    state, observation = (
        follow_drawn(8, planar=False, method=method)[20],
        insert(8, planar=False).observations[20],
    )
    chosen = settings(planar=False, method=method)
    first, second = (step_tip(state, observation, chosen) for _ in range(2))
    np.testing.assert_array_equal(first.pose, second.pose)
    for values in (first.pose, first.covariance):
        with pytest.raises(ValueError, match="read-only"):
            values[0, 0] = 1.0


@METHODS
def test_a_roll_without_an_advance_turns_the_tip(method):
    """A flip in place is a rotation: the needle's axis stays, its bend changes sides."""
    chosen = settings(planar=False, method=method)
    state = follow(insert(9, planar=False), chosen)[40]
    flipped = step_tip(state, TipObservation(None, 0.0, math.pi), chosen)
    np.testing.assert_allclose(flipped.rotation, state.rotation @ np.diag((-1.0, -1.0, 1.0)), atol=1e-12)
    np.testing.assert_array_equal(flipped.position_mm, state.position_mm)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"positions_mm": [(0.0, 0.0, 0.0), (0.0, math.nan, 1.0)]}, r"positions_mm\[1, 1\] is nan"),
        ({"positions_mm": np.zeros((101, 2))}, r"positions_mm has shape \(101, 2\), expected \(N, 3\)"),
        ({"positions_mm": np.zeros((0, 3))}, "positions_mm is empty"),
        ({"positions_mm": [["a", "b", "c"]]}, "positions_mm is not an array of numbers"),
        ({"roll_rad": np.zeros(101)}, r"roll_rad has shape \(101,\), expected \(100\)"),
        ({"step_mm": 0.0}, "step_mm is 0"),
        ({"radius_mm": 0.0}, "radius_mm is 0"),
        ({"radius_mm": math.nan}, "radius_mm is nan"),
        ({"observation_sd_mm": 0.0}, "observation_sd_mm is 0"),
        ({"process_sd_rad": -0.1}, r"process_sd_deg_per_root_mm is -5\.7"),
        ({"method": "kalman"}, "method is kalman"),
        ({"start": np.eye(3)}, r"start has shape \(3, 3\), expected \(4, 4\)"),
        ({"start": np.diag((1.0, 1.0, -1.0, 1.0))}, "3x3 of start is not a rotation"),
        ({"start": np.full((4, 4), math.nan)}, r"start\[0, 0\] is nan"),
        ({"start": np.diag((1.0, 1.0, 1.0, 2.0))}, "last row of start"),
    ],
)
def test_bad_input_is_named(changes, message):
    """Invalid input is an InputError with its name, index and value."""
    with pytest.raises(InputError, match=message):
        estimate(insert(0, planar=False), **changes)


def test_a_state_says_where_it_heads():
    """The heading is zero along z and positive towards +y; a bend at roll zero goes to -y.

    Before the first step the pose is the start's.
    """
    poses = estimate_tip_poses([(1.0, 2.0, 3.0)], 1.0, [], 27.6, 0.2, 0.005)
    np.testing.assert_array_equal(poses, [np.block([[np.eye(3), np.c_[[1.0, 2.0, 3.0]]], [0, 0, 0, 1]])])
    state = start_tip(np.eye(4), settings(planar=True))
    moved = step_tip(state, TipObservation(None, 5.0), settings(planar=True))
    assert (state.heading_rad, moved.heading_rad) == pytest.approx((0.0, -5.0 / RADIUS_MM))


ANGLES = st.tuples(st.floats(-3.1, 3.1), st.floats(-1.5, 1.5), st.floats(-3.1, 3.1)).map(np.array)
STEP = 1e-6


@given(roll_rad=st.floats(-4.0, 4.0), step_mm=st.floats(0.0, 30.0), radius_mm=st.floats(1.0, 1e4))
def test_a_step_is_an_arc(roll_rad: float, step_mm: float, radius_mm: float) -> None:
    """Equations (16) and (17) by curvature are (5) and (6) by radius."""
    rotation, origin_mm = step_frame(roll_rad, step_mm, 1.0 / radius_mm)
    position_mm, turned = arc_pose(step_mm / radius_mm, roll_rad, radius_mm)
    np.testing.assert_allclose(origin_mm, position_mm, atol=1e-10)
    np.testing.assert_allclose(rotation, turned, atol=1e-12)
    np.testing.assert_array_equal(step_frame(0.0, step_mm, 0.0)[1], (0.0, 0.0, step_mm))


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
