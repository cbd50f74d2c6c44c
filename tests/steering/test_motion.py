"""Rotations of the tip and their vectors."""

import numpy as np
from scipy.spatial.transform import Rotation

from labrig.steering.motion import rotation_from_vector, vector_from_rotation


def test_a_rotation_vector_has_the_bits_of_scipys() -> None:
    """Small and large turns, in the plane and in space, about any axis: the bits that records were made with."""
    random = np.random.default_rng(0)
    for size_rad in np.geomspace(1e-9, 3.1, 200):
        axis = random.standard_normal(3)
        for vector in (size_rad * axis / np.linalg.norm(axis), np.array((size_rad, 0.0, 0.0))):
            rotation = rotation_from_vector(vector)
            assert np.array_equal(vector_from_rotation(rotation), Rotation.from_matrix(rotation).as_rotvec())
