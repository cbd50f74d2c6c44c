"""Rotations of the tip and their vectors."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from labrig.steering.motion import rotation_from_vector, vector_from_rotation


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
