"""The uncertainty of a plane map that comes from a bend of the ruled paper."""

import cv2
import numpy as np
import pytest

from labrig.vision.calibrate_plane import find_bent_homographies

DISTANCE_MM = 120.0
FOOT_MM = np.array([36.0, 24.0])
CAMERA = np.array([[1800.0, 0.0, 640.0], [0.0, 1800.0, 360.0], [0.0, 0.0, 1.0]])
GRID_MM = np.stack(np.meshgrid(np.arange(2.0, 72.0), np.arange(2.0, 46.0)), axis=-1).reshape(-1, 2)


def project(places_mm, heights_mm, noise=0.05, seed=0):
    """Return the pixels (N, 2) at which a camera over `FOOT_MM` sees points of that height over the plane."""
    flat = places_mm - FOOT_MM
    px = CAMERA[0, 0] * flat / (DISTANCE_MM - heights_mm)[:, None] + CAMERA[:2, 2]
    return px + np.random.default_rng(seed).normal(0.0, noise, px.shape)


def sheet(height_mm, angle_rad):
    """Return the heights (N,) of a sheet that is bent about a line of this direction, their mean zero."""
    along = (GRID_MM - GRID_MM.mean(axis=0)) @ [np.cos(angle_rad), np.sin(angle_rad)]
    roof = height_mm * (1.0 - (along / np.abs(along).max()) ** 2)
    return roof - roof.mean()


def apply_homography(homography, px):
    """Return where a homography puts pixels (N, 2)."""
    return cv2.perspectiveTransform(px[None], homography)[0]


@pytest.mark.parametrize("seed", range(2))
def test_flat_paper_leaves_nothing_uncertain(seed):
    """Noise alone is not a bend."""
    assert find_bent_homographies(project(GRID_MM, np.zeros(len(GRID_MM)), seed=seed), GRID_MM, FOOT_MM) == []


@pytest.mark.parametrize("angle_deg", [0.0, 140.0])
@pytest.mark.parametrize("height_mm", [0.4, -0.8])
def test_map_without_the_bend_and_with_it_are_as_far_apart_as_the_map_is_wrong(height_mm, angle_deg):
    """The other homographies predict the error of the plane's own points to a fifth."""
    px = project(GRID_MM, sheet(height_mm, np.deg2rad(angle_deg)))
    fitted = cv2.findHomography(px, GRID_MM)[0]
    plane_px = project(GRID_MM, np.zeros(len(GRID_MM)), noise=0.0)
    wrong = apply_homography(fitted, plane_px) - GRID_MM
    bent, raised = find_bent_homographies(px, GRID_MM, FOOT_MM)
    predicted = apply_homography(fitted, plane_px) - apply_homography(bent, plane_px)
    assert np.sqrt(np.mean(wrong**2)) > 0.005
    assert np.sqrt(np.mean((predicted - wrong) ** 2)) < 0.2 * np.sqrt(np.mean(wrong**2))
    height = np.sqrt(
        np.mean(
            np.sum((apply_homography(raised, plane_px) - apply_homography(fitted, plane_px)) ** 2, axis=1)
        )
    )
    assert height == pytest.approx(
        np.std(sheet(height_mm, np.deg2rad(angle_deg)))
        / DISTANCE_MM
        * np.sqrt(np.mean(np.sum((GRID_MM - FOOT_MM) ** 2, axis=1))),
        rel=0.3,
    )
