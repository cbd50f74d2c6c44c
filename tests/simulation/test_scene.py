"""Pictures of the simulated camera, measured independently and compared with the truth."""

from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from labrig.simulation.description import WorldDescription
from labrig.simulation.lens import plane_to_pixels
from tests.simulation.benches import QUIET, bench, centre_line_mm, insert, withdraw

Floats = npt.NDArray[np.float64]
OFFSETS_MM = np.arange(-1.4, 1.4001, 0.02)


def profiles(picture: npt.NDArray[np.uint8], line_mm: Floats) -> Floats:
    """Return the brightness across a line (N, 2) at `OFFSETS_MM`, positive towards +y: (N, K)."""
    tangent = np.gradient(line_mm, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1)[:, None]
    normal = np.stack([tangent[:, 1], -tangent[:, 0]], axis=1)
    points = line_mm[:, None] + OFFSETS_MM[None, :, None] * normal[:, None]
    pixels = plane_to_pixels(points.reshape(-1, 2), QUIET.lens).reshape(*points.shape).astype(np.float32)
    sampled = cv2.remap(picture.astype(np.float32), pixels[..., 0], pixels[..., 1], cv2.INTER_CUBIC)
    return np.asarray(sampled, float)


def edge_mm(profile: Floats, low_mm: float, high_mm: float) -> float:
    """Return the centroid of the gradient's size between two offsets."""
    within = np.abs(OFFSETS_MM - 0.5 * (low_mm + high_mm)) <= 0.5 * (high_mm - low_mm)
    steepness = np.abs(np.gradient(profile))[within]
    return float((steepness * OFFSETS_MM[within]).sum() / steepness.sum())


@pytest.mark.parametrize("roll_rad", [0.0, np.pi])
def test_the_needle_s_edges_stand_where_the_truth_says(roll_rad: float) -> None:
    """Along the shaft both edges lie 0.6 mm from the true centre line, their middle within 0.01 mm."""
    world = bench(WorldDescription(bubbles_per_specimen=0))
    insert(world, 40.0, roll_rad=roll_rad)
    line = centre_line_mm(world, 401)
    across = profiles(world.picture(), line)
    in_view = plane_to_pixels(line, QUIET.lens)[:, 1] > 20
    for start in range(20, 380, 60):
        if in_view[start : start + 60].all():
            mean = across[start : start + 60].mean(axis=0)
            edges = edge_mm(mean, -0.82, -0.42), edge_mm(mean, 0.42, 0.82)
            assert edges == pytest.approx((-0.6, 0.6), abs=0.02)
            assert abs(sum(edges)) / 2 < 0.01


def test_the_needle_ends_at_its_true_tip() -> None:
    """Just behind the tip the bevel's leading side is steel; just beyond it there is gel."""
    world = bench()
    insert(world, 40.0)
    picture, line = world.picture().astype(float), centre_line_mm(world, 4001)
    tip, along = line[-1], (line[-1] - line[-2]) / np.linalg.norm(line[-1] - line[-2])
    leading = tip - 0.35 * np.array([along[1], -along[0]])
    places = leading + np.array([[-0.6], [0.35]]) * along
    behind, beyond = (picture[round(v), round(u)] for u, v in plane_to_pixels(places, QUIET.lens))
    assert behind < 0.5 * beyond


def test_the_sheath_ends_at_its_true_tip() -> None:
    """Grey steel of 2 mm up to the tip, and no further."""
    world = bench()
    world.advance(0.0, 0.0, 15.0)
    truth: Any = world.truth()
    y, z = truth["sheath_tip_mm"]
    picture = world.picture()
    body = profiles(picture, np.stack([np.full(60, y), z - np.linspace(8.0, 1.0, 60)], axis=1)).mean(axis=0)
    assert (edge_mm(body, -1.2, -0.85), edge_mm(body, 0.85, 1.2)) == pytest.approx((-1, 1), abs=0.03)
    beyond = profiles(picture, np.stack([np.full(60, y), z + np.linspace(0.3, 8.0, 60)], axis=1)).mean(axis=0)
    assert np.ptp(beyond) < 12


def test_a_withdrawn_needle_leaves_a_faint_track_that_moves_with_the_gel() -> None:
    """Shifted by 10 mm, the slit is seen 10 mm towards +y, darker than its surroundings but only faintly."""
    world = bench()
    insert(world, 40.0)
    line = centre_line_mm(world)
    withdraw(world)
    world.shift_to_hole("A", 1, 45.0)
    shifted = line + np.array([10.0, 0.0])
    seen = plane_to_pixels(shifted, QUIET.lens)[:, 1] > 25
    mean = profiles(world.picture(), shifted[seen]).mean(axis=0)
    around = mean[np.abs(OFFSETS_MM) > 0.8].mean()
    slit = mean[np.abs(OFFSETS_MM) < 0.1].mean()
    assert 0.85 * around < slit < 0.98 * around
    assert np.ptp(profiles(world.picture(), line).mean(axis=0)) < 8
