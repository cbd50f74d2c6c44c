"""The world's own projection."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from labrig.errors import InputError
from labrig.simulation.description import LensDescription
from labrig.simulation.lens import (
    plane_to_pixels,
    project,
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


def test_a_lens_that_folds_the_picture_is_refused() -> None:
    """Distortion without an inverse names itself instead of drawing nonsense."""
    lens = LensDescription(distortion=(-9.0, 0.0, 0.0, 0.0, 0.0))
    with pytest.raises(InputError, match="no inverse"):
        undistort(np.array([[0.36, 0.2]]), lens)


def test_the_plane_stands_where_the_description_says() -> None:
    """Its origin is seen at origin_px, distance and tilt are those of the optical axis; z goes right and y up."""
    assert plane_to_pixels(np.zeros((1, 2)), LENS)[0] == pytest.approx(LENS.origin_px, abs=1e-6)
    pose = steering_plane_pose(LENS)
    normal = pose.rotation[:, 2]
    assert normal @ pose.translation_mm / normal[2] == pytest.approx(LENS.distance_mm)
    assert np.degrees(np.arccos(normal[2])) == pytest.approx(LENS.tilt_deg)
    assert np.linalg.det(pose.rotation) == pytest.approx(1)
    along, up = plane_to_pixels(np.array([[0.0, 10.0], [10.0, 0.0]]), PLAIN) - PLAIN.origin_px
    assert along == pytest.approx([10 * PLAIN.fx_px / PLAIN.distance_mm, 0])
    assert up == pytest.approx([0, -10 * PLAIN.fy_px / PLAIN.distance_mm])
