"""The world's own lens, and pictures of the simulated camera: measured independently and compared with the truth.

What is out of the plane is compared with a pinhole camera of our own: cv2.projectPoints on points in space.
"""

from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st

from labrig.errors import InputError
from labrig.simulation.description import LensDescription, WorldDescription
from labrig.simulation.gel import Ball
from labrig.simulation.lens import (
    plane_to_pixels,
    project,
    see_points,
    steering_plane_pose,
    undistort,
    unproject,
)
from labrig.simulation.world import World
from tests.simulation.benches import (
    QUIET,
    STILL_SHEATH,
    before_gel,
    bench,
    centre_line_mm,
    insert,
    one_radius,
    withdraw,
)

Floats = npt.NDArray[np.float64]
OFFSETS_MM = np.arange(-1.4, 1.4001, 0.02)
LENS = LensDescription(distance_mm=185.0, origin_px=(150.0, 310.0), tilt_deg=6.0)
STRAIGHT = {"distance_mm": 185, "origin_px": [150, 310], "tilt_deg": 0, "roll_deg": 0}
PLAIN = LensDescription(distortion=(0.0,) * 5, tilt_deg=0.0, roll_deg=0.0)
MARKER: dict[str, Any] = {"marker_id": 7, "side_mm": 6, "position_mm": [-12, 25], "turn_deg": 30}


@given(u=st.floats(0, 1279), v=st.floats(0, 719), depth_mm=st.floats(10, 1000))
def test_a_ray_ends_in_the_pixel_it_came_from(u: float, v: float, depth_mm: float) -> None:
    """Unprojecting a pixel and projecting any point of its ray gives the pixel back."""
    pixel = np.array([[u, v]])
    assert project(unproject(pixel, QUIET.lens) * depth_mm, QUIET.lens) == pytest.approx(pixel, abs=1e-6)


def test_a_lens_that_folds_the_picture_is_refused() -> None:
    """Distortion without an inverse names itself instead of drawing nonsense."""
    with pytest.raises(InputError, match="no inverse"):
        undistort(np.array([[0.36, 0.2]]), LensDescription(distortion=(-9.0, 0.0, 0.0, 0.0, 0.0)))


def test_the_plane_stands_where_the_description_says() -> None:
    """Its origin is seen at origin_px, distance and tilt are those of the optical axis; z goes right and y up."""
    assert plane_to_pixels(np.zeros((1, 2)), QUIET.lens)[0] == pytest.approx(QUIET.lens.origin_px, abs=1e-6)
    pose = steering_plane_pose(QUIET.lens)
    normal = pose.rotation[:, 2]
    assert normal @ pose.translation_mm / normal[2] == pytest.approx(QUIET.lens.distance_mm)
    assert np.degrees(np.arccos(normal[2])) == pytest.approx(QUIET.lens.tilt_deg)
    assert np.linalg.det(pose.rotation) == pytest.approx(1)
    along, up = plane_to_pixels(np.array([[0.0, 10.0], [10.0, 0.0]]), PLAIN) - PLAIN.origin_px
    assert along == pytest.approx([10 * PLAIN.fx_px / PLAIN.distance_mm, 0])
    assert up == pytest.approx([0, -10 * PLAIN.fy_px / PLAIN.distance_mm])


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
    points = np.random.default_rng(4).uniform((-15.0, -35.0, 0.0), (15.0, 25.0, 110.0), (200, 3))
    seen, _ = see_points(points, LENS)
    assert plane_to_pixels(seen, LENS) == pytest.approx(project_by_opencv(points, LENS), abs=0.01)


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


def test_the_glint_lies_where_the_normal_bisects_lamp_and_camera() -> None:
    """The lamp stands aside, 1.2 times as high as far away; the needle is straight."""
    world = bench(QUIET.model_copy(update={"light": QUIET.light.model_copy(update={"azimuth_deg": 90.0})}))
    insert(world, 6.0)
    across = profiles(world.picture(), centre_line_mm(world)[100:300]).mean(axis=0)
    glint_mm = OFFSETS_MM[np.argmax(np.where(np.abs(OFFSETS_MM) < 0.5, across, 0.0))]
    assert glint_mm == pytest.approx(0.6 * np.sin((np.pi / 2 - np.arctan(1.2)) / 2), abs=0.03)


def test_a_withdrawn_needle_leaves_a_faint_track_that_moves_with_the_gel() -> None:
    """Shifted by 10 mm, the slit is seen 10 mm towards +y, darker than its surroundings but only faintly."""
    world = bench()
    insert(world, 40.0)
    line = centre_line_mm(world)
    withdraw(world)
    world.shift_to_hole("A", 1, 45.0)
    shifted = line + np.array([10.0, 0.0])
    mean = profiles(world.picture(), shifted[plane_to_pixels(shifted, QUIET.lens)[:, 1] > 25]).mean(axis=0)
    around = mean[np.abs(OFFSETS_MM) > 0.8].mean()
    assert 0.85 * around < mean[np.abs(OFFSETS_MM) < 0.1].mean() < 0.98 * around
    assert np.ptp(profiles(world.picture(), line).mean(axis=0)) < 8


def test_the_needle_is_drawn_where_and_as_wide_as_its_distance_makes_it() -> None:
    """Far out of the plane, the dark shaft's edges stand where OpenCV projects the ends of its diameter."""
    world = before_gel(
        2, lens=STRAIGHT | {"origin_px": [150, 600]}, blur_px=0, light={"glint": 0, "unevenness": 0},
        gels=one_radius(1000), sheath=STILL_SHEATH | {"x_play_sd_mm": 40},
    )  # fmt: skip
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
    """The middle of its disc is where OpenCV projects its centre; the gel shines through it."""
    worlds = [before_gel(2, balls, lens=STRAIGHT) for balls in ([], [Ball((12.0, -20.0, 90.0), 6.0)])]
    bare, cast = (world.picture().astype(int) for world in worlds)
    changed = np.argwhere(np.abs(cast - bare) > 8)
    middle = (changed.max(axis=0) + changed.min(axis=0)) / 2
    expected = project_by_opencv(np.array([(12.0, -20.0, 90.0)]), worlds[0].description.lens)[0]
    assert middle[::-1] == pytest.approx(expected, abs=1.0)
    assert float(np.ptp(changed[:, 0])) == pytest.approx(12.0 * 1802.0 / (185.0 + 12.0), rel=0.03)
    row, column = middle.astype(int)
    assert 0.5 < cast[row, column] / bare[row, column] < 0.9


def with_marker(target_moves_mm: float = 0.0, **changes: object) -> World:
    """Return a world with a marker before a phantom whose target is known."""
    world = before_gel(5, (), markers=[MARKER | changes], target_moves_mm=target_moves_mm)
    world.aim_at((0.0, 0.0, 60.0))
    return world


def find_ink(shown: World, inserted_mm: float = 0.0) -> Floats | None:
    """Return the middle (u, v) of what is darker than in a world without markers; None if nothing is."""
    bare = before_gel(5, ())
    insert(bare, inserted_mm)
    v, u = np.nonzero(bare.picture().astype(int) - shown.picture() > 60)
    return np.array([u.min() + u.max(), v.min() + v.max()]) / 2 if len(u) else None


@pytest.mark.parametrize("x_mm", [0.0, -15.0])
def test_a_marker_is_drawn_where_the_lens_sees_it(x_mm: float) -> None:
    """The middle of its ink is where its centre's line of sight ends, in the plane and before it."""
    seen, _ = see_points(np.array([(x_mm, *MARKER["position_mm"])]), QUIET.lens)
    assert find_ink(with_marker(x_mm=x_mm)) == pytest.approx(plane_to_pixels(seen, QUIET.lens)[0], abs=1.0)


def test_a_marker_moves_with_the_target_and_is_covered_where_it_is_said_to_be() -> None:
    """Target and marker are displaced by as much; while it is covered there is no marker."""
    shown = with_marker(15.0, covered_mm=[20, 90])
    insert(shown, 12.0)
    target_mm = shown.locate_target_mm()
    assert target_mm is not None
    displaced_mm = np.array(target_mm[1:]) - (0.0, 60.0)
    assert np.linalg.norm(displaced_mm) == pytest.approx(3.0, abs=0.01)
    px = plane_to_pixels(np.array([displaced_mm + MARKER["position_mm"]]), QUIET.lens)[0]
    assert find_ink(shown, 12.0) == pytest.approx(px, abs=1.0)
    insert(shown, 25.0)
    assert find_ink(shown, 25.0) is None
