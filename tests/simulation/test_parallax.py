"""Parallax against a pinhole camera of our own: cv2.projectPoints on points in space."""

import json
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from labrig.simulation.description import LensDescription, WorldDescription
from labrig.simulation.gel import Ball
from labrig.simulation.lens import plane_to_pixels, see_points
from labrig.simulation.world import World
from tests.simulation.benches import centre_line_mm

Floats = npt.NDArray[np.float64]

LENS = LensDescription(distance_mm=185.0, origin_px=(150.0, 310.0), tilt_deg=6.0)
STRAIGHT_LENS = {"distance_mm": 185, "origin_px": [150, 310], "tilt_deg": 0, "roll_deg": 0}


def project_by_opencv(points_mm: Floats, lens: LensDescription) -> Floats:
    """Return the pixels (N, 2) of points (N, 3), (x, y, z), by a pose fitted to points of the plane alone."""
    matrix = np.array([[lens.fx_px, 0, lens.cx_px], [0, lens.fy_px, lens.cy_px], [0, 0, 1]])
    distortion = np.array(lens.distortion)
    grid = np.array([(y, z) for y in np.linspace(-35, 25, 7) for z in np.linspace(-10, 110, 9)])
    # z to the right, -y down and x away from the camera are right-handed.
    flat = np.column_stack((grid[:, 1], -grid[:, 0], np.zeros(len(grid))))
    _, turn, shift = cv2.solvePnP(flat, plane_to_pixels(grid, lens), matrix, distortion)
    turn, shift = cv2.solvePnPRefineLM(flat, plane_to_pixels(grid, lens), matrix, distortion, turn, shift)
    solid = np.column_stack((points_mm[:, 2], -points_mm[:, 1], points_mm[:, 0]))
    pixels, _ = cv2.projectPoints(solid, turn, shift, matrix, distortion)
    return np.asarray(pixels.reshape(-1, 2), float)


def test_a_point_is_seen_where_a_pinhole_sees_it() -> None:
    """Points up to 15 mm before and behind the plane appear at the pixels that OpenCV projects them to."""
    random = np.random.default_rng(4)
    points = random.uniform((-15.0, -35.0, 0.0), (15.0, 25.0, 110.0), (200, 3))
    seen, _ = see_points(points, LENS)
    assert plane_to_pixels(seen, LENS) == pytest.approx(project_by_opencv(points, LENS), abs=0.01)


def test_the_needle_is_drawn_where_and_as_wide_as_its_distance_makes_it() -> None:
    """Far out of the plane, the dark shaft's edges stand where OpenCV projects the ends of its diameter."""
    values = {
        "lens": STRAIGHT_LENS | {"origin_px": [150, 600]},
        "noise_sd": 0, "blur_px": 0, "bubbles_per_specimen": 0,
        "light": {"glint": 0, "unevenness": 0},
        "gels": [{"gelatin_percent": 13, "radius_mean_mm": 1000, "radius_sd_mm": 0}],
        "sheath": {"lateral_play_sd_mm": 0, "angle_play_sd_deg": 0, "x_play_sd_mm": 40},
    }  # fmt: skip
    world = World(WorldDescription.model_validate_json(json.dumps(values)), 2)
    world.mount_needle("N1")
    world.place_specimen("block", 13.0)
    world.advance(0.0, 0.0, 15.0)
    world.advance(80.0, 0.0, 15.0)
    x_mm = world.tip_mm()[0]
    assert abs(x_mm) > 20.0
    line = centre_line_mm(world)
    y_mm = float(np.interp(50.0, line[:, 1], line[:, 0]))
    rims = np.array([(x_mm, y_mm + side * 0.6, 50.0) for side in (1.0, -1.0)])
    (u, top), (_, bottom) = project_by_opencv(rims, world.description.lens)
    column = world.picture()[:, round(u)].astype(float)
    half = 0.6 * np.median(column)
    dark = np.flatnonzero(column < half)
    for last, beyond, rim in ((dark[0], dark[0] - 1, top), (dark[-1], dark[-1] + 1, bottom)):
        crossing = np.interp(half, (column[last], column[beyond]), (last, beyond))
        assert crossing == pytest.approx(rim, abs=0.3)


def test_an_obstacle_out_of_the_plane_is_seen_aside_and_smaller() -> None:
    """The middle of its disc is where OpenCV projects its centre."""
    values: dict[str, Any] = {"lens": STRAIGHT_LENS, "noise_sd": 0, "bubbles_per_specimen": 0}
    pictures = []
    for balls in ([], [Ball((12.0, -20.0, 90.0), 6.0)]):
        world = World(WorldDescription.model_validate_json(json.dumps(values)), 2)
        world.place_phantom("block", 13.0, balls)
        pictures.append(world.picture().astype(int))
    changed = np.argwhere(np.abs(pictures[1] - pictures[0]) > 8)
    middle = (changed.max(axis=0) + changed.min(axis=0)) / 2
    expected = project_by_opencv(np.array([(12.0, -20.0, 90.0)]), world.description.lens)[0]
    assert middle[::-1] == pytest.approx(expected, abs=1.0)
    height_px = float(np.ptp(changed[:, 0]))
    assert height_px == pytest.approx(12.0 * 1802.0 / (185.0 + 12.0), rel=0.03)
