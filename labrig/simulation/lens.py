"""The world's own camera: a pinhole with Brown-Conrady distortion above the steering plane.

The camera frame has X to the right, Y down and Z along the optical axis. In the steering plane frame z runs
along the insertion (right in the picture), y up and x away from the camera.
"""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from labrig.errors import InputError
from labrig.simulation.description import LensDescription

Floats = npt.NDArray[np.float64]
Field32 = npt.NDArray[np.float32]

_UNDISTORT_STEPS = 12  # each step gains about a digit for the distortion of a good lens
_UNDISTORT_LIMIT = 1e-6  # change in the last step, normalised; a few thousandths of a pixel


def distort(a: Floats, b: Floats, lens: LensDescription) -> tuple[Floats, Floats]:
    """Apply the lens's distortion to ideal normalised coordinates; Brown 1966."""
    k1, k2, p1, p2, k3 = lens.distortion
    r2 = a * a + b * b
    scale = 1 + r2 * (k1 + r2 * (k2 + r2 * k3)) + 2 * (p1 * b + p2 * a)
    return a * scale + p2 * r2, b * scale + p1 * r2


def undistort(distorted: Floats, lens: LensDescription) -> Floats:
    """Invert `distort` by a fixed-point iteration; (N, 2) in, (N, 2) out.

    Raises
    ------
    InputError
        For a distortion so strong that the lens folds the picture.
    """
    a_seen, b_seen = np.ascontiguousarray(distorted.T)
    a, b, a_missed, b_missed = a_seen, b_seen, a_seen, b_seen
    with np.errstate(over="ignore", invalid="ignore"):
        for _ in range(_UNDISTORT_STEPS):
            a_found, b_found = distort(a, b, lens)
            a_missed, b_missed = a_seen - a_found, b_seen - b_found
            a, b = a + a_missed, b + b_missed
    if not np.abs([a_missed, b_missed]).max() < _UNDISTORT_LIMIT:
        message = (
            f"the distortion {list(lens.distortion)} of the world's lens has no inverse over the picture"
        )
        raise InputError(message, "weaken k1, k2 and k3 under `world: lens:` in the rig file")
    return np.column_stack((a, b))


def project(points_camera_mm: Floats, lens: LensDescription) -> Floats:
    """Return the pixels (N, 2) of points (N, 3) in the camera frame [mm]."""
    a, b = (points_camera_mm[:, :2] / points_camera_mm[:, 2:]).T
    seen = np.column_stack(distort(a, b, lens))
    return seen * (lens.fx_px, lens.fy_px) + (lens.cx_px, lens.cy_px)


def unproject(pixels: Floats, lens: LensDescription) -> Floats:
    """Return the directions (N, 3), third component 1, of the rays that end in pixels (N, 2)."""
    ideal = undistort((pixels - (lens.cx_px, lens.cy_px)) / (lens.fx_px, lens.fy_px), lens)
    return np.concatenate([ideal, np.ones_like(ideal[:, :1])], axis=1)


def rotation_about(axis: Floats, angle_rad: float) -> Floats:
    """Return the 3x3 right-handed rotation about a unit vector (Rodrigues)."""
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    rotation: Floats = np.eye(3) + math.sin(angle_rad) * cross + (1 - math.cos(angle_rad)) * (cross @ cross)
    return rotation


@dataclass(frozen=True)
class Pose:
    """A plane before the camera: its point p is at `rotation @ p + translation_mm` in the camera frame.

    rotation (3, 3), translation_mm (3,); the plane spans its first two axes.
    """

    rotation: Floats
    translation_mm: Floats

    def to_camera(self, flat_mm: Floats) -> Floats:
        """Return points (N, 2) of the plane in the camera frame (N, 3) [mm]."""
        camera: Floats = flat_mm @ self.rotation[:, :2].T + self.translation_mm
        return camera

    def intersect(self, rays: npt.NDArray[np.floating]) -> tuple[Field32, Field32]:
        """Return the plane coordinates [mm] at which rays (..., 3) meet the plane."""
        normal = self.rotation[:, 2]
        depth = (normal @ self.translation_mm) / (rays @ normal.astype(rays.dtype))
        offset = self.rotation[:, :2].T @ self.translation_mm
        first = (rays @ self.rotation[:, 0].astype(rays.dtype)) * depth - offset[0]
        second = (rays @ self.rotation[:, 1].astype(rays.dtype)) * depth - offset[1]
        return first.astype(np.float32), second.astype(np.float32)


@lru_cache(maxsize=2)
def steering_plane_pose(lens: LensDescription) -> Pose:
    """Return the pose of the steering plane, flat coordinates (y, z), whose origin is seen at origin_px."""
    # Columns: y, z, x in the camera frame.
    upright = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    azimuth = math.radians(lens.tilt_azimuth_deg)
    tilt = rotation_about(np.array([math.cos(azimuth), math.sin(azimuth), 0.0]), math.radians(lens.tilt_deg))
    roll = rotation_about(np.array([0.0, 0.0, 1.0]), math.radians(lens.roll_deg))
    rotation = roll @ tilt @ upright
    ray = unproject(np.array([lens.origin_px]), lens)[0]
    normal = rotation[:, 2]
    return Pose(rotation, ray * (normal[2] * lens.distance_mm / (normal @ ray)))


@lru_cache(maxsize=2)
def camera_place_mm(lens: LensDescription) -> tuple[float, float, float]:
    """Return the centre of projection in the steering plane's frame, (x, y, z); x is negative."""
    pose = steering_plane_pose(lens)
    y, z, x = (-pose.rotation.T @ pose.translation_mm).tolist()
    return x, y, z


@dataclass(frozen=True)
class PixelPlane:
    """Where each pixel's ray meets the steering plane, y_mm and z_mm (H, W), and a pixel's size there."""

    y_mm: Field32
    z_mm: Field32
    mm_per_px: float


@lru_cache(maxsize=1)
def pixel_rays(lens: LensDescription) -> Floats:
    """Return the direction of every pixel's ray, (H, W, 3)."""
    u, v = np.meshgrid(np.arange(lens.width_px, dtype=float), np.arange(lens.height_px, dtype=float))
    rays = unproject(np.stack([u.ravel(), v.ravel()], axis=1), lens)
    return rays.reshape(lens.height_px, lens.width_px, 3)


@lru_cache(maxsize=2)
def pixel_plane(lens: LensDescription) -> PixelPlane:
    """Return the steering plane's coordinates of every pixel."""
    y_mm, z_mm = steering_plane_pose(lens).intersect(pixel_rays(lens))
    return PixelPlane(y_mm, z_mm, float(np.median(np.diff(z_mm, axis=1))))


def plane_to_pixels(plane_mm: Floats, lens: LensDescription) -> Floats:
    """Return the pixels (N, 2) of points (N, 2) of the steering plane, columns (y, z) [mm]."""
    return project(steering_plane_pose(lens).to_camera(plane_mm), lens)


def see_points(points_mm: Floats, lens: LensDescription) -> tuple[Floats, Floats]:
    """Return where in the plane (N, 2), as (y, z), points (N, 3) are seen, and their scales (N,)."""
    camera_x, *foot = camera_place_mm(lens)
    growth = points_mm[:, 0] / (camera_x - points_mm[:, 0])
    flat = points_mm[:, 1:]
    return flat + growth[:, None] * (flat - foot), 1.0 + growth
