"""The world's own projection."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from labrig.errors import InputError
from labrig.simulation.description import LensDescription
from labrig.simulation.lens import (
    Pose,
    distort,
    pixel_plane,
    plane_to_pixels,
    project,
    rotation_about,
    steering_plane_pose,
    undistort,
    unproject,
)

LENS = LensDescription()
PLAIN = LensDescription(distortion=(0.0, 0.0, 0.0, 0.0, 0.0), tilt_deg=0.0, roll_deg=0.0)


@given(u=st.floats(0, 1279), v=st.floats(0, 719), depth_mm=st.floats(10, 1000))
def test_a_ray_ends_in_the_pixel_it_came_from(u: float, v: float, depth_mm: float) -> None:
    """Unprojecting a pixel and projecting any point of its ray gives the pixel back."""
    pixel = np.array([[u, v]])
    assert project(unproject(pixel, LENS) * depth_mm, LENS) == pytest.approx(pixel, abs=1e-6)


def test_distortion_follows_its_definition() -> None:
    """One point by hand: radial k1 and tangential p1, p2 add up as Brown wrote them."""
    lens = LensDescription(distortion=(0.1, 0.0, 0.01, 0.02, 0.0))
    seen = distort(np.array([0.3, 0.4]), lens)
    radial = 1 + 0.1 * 0.25
    expected = (
        0.3 * radial + 2 * 0.01 * 0.12 + 0.02 * (0.25 + 2 * 0.09),
        0.4 * radial + 0.01 * (0.25 + 2 * 0.16) + 2 * 0.02 * 0.12,
    )
    assert seen == pytest.approx(expected)


def test_a_lens_that_folds_the_picture_is_refused() -> None:
    """Distortion without an inverse names itself instead of drawing nonsense."""
    lens = LensDescription(distortion=(-9.0, 0.0, 0.0, 0.0, 0.0))
    with pytest.raises(InputError, match="no inverse"):
        undistort(np.array([[0.36, 0.2]]), lens)


def test_the_origin_of_the_plane_is_seen_where_the_description_says() -> None:
    """Tilt, roll and distortion leave the origin at origin_px."""
    assert plane_to_pixels(np.zeros((1, 2)), LENS)[0] == pytest.approx(LENS.origin_px, abs=1e-6)


def test_insertion_to_the_right_has_y_up() -> None:
    """Without tilt, 10 mm along z go right by f/d each, and 10 mm along y go up."""
    along, up = plane_to_pixels(np.array([[0.0, 10.0], [10.0, 0.0]]), PLAIN) - PLAIN.origin_px
    assert along == pytest.approx([10 * PLAIN.fx_px / PLAIN.distance_mm, 0])
    assert up == pytest.approx([0, -10 * PLAIN.fy_px / PLAIN.distance_mm])


def test_the_plane_stands_at_its_distance_and_tilt() -> None:
    """The optical axis meets the plane distance_mm away, at the tilt from its normal."""
    pose = steering_plane_pose(LENS)
    normal = pose.rotation[:, 2]
    assert normal @ pose.translation_mm / normal[2] == pytest.approx(LENS.distance_mm)
    assert np.degrees(np.arccos(normal[2])) == pytest.approx(LENS.tilt_deg)
    assert np.linalg.det(pose.rotation) == pytest.approx(1)


def test_the_map_of_all_pixels_inverts_the_projection() -> None:
    """Points of the plane at each pixel's foot are seen in that pixel."""
    plane = pixel_plane(LENS)
    rows, columns = np.mgrid[0:720:31, 0:1280:37]
    feet = np.stack([plane.y_mm[rows, columns].ravel(), plane.z_mm[rows, columns].ravel()], axis=1)
    seen = plane_to_pixels(feet.astype(float), LENS)
    assert seen == pytest.approx(np.stack([columns.ravel(), rows.ravel()], axis=1), abs=1e-3)


def test_a_pose_meets_the_rays_of_its_own_points() -> None:
    """Cutting the rays of a tilted board's points with the board gives the points back."""
    pose = Pose(rotation_about(np.array([0.6, 0.8, 0.0]), 0.6), np.array([5.0, -3.0, 200.0]))
    points = np.array([[0.0, 0.0], [40.0, 10.0], [-30.0, 25.0]])
    x, y = pose.intersect(pose.to_camera(points))
    assert np.stack([x, y], axis=1) == pytest.approx(points, abs=1e-4)
