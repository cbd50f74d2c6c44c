"""Targets that calibrate the camera: graph paper and a hand-held chessboard."""

import math
from dataclasses import dataclass

import numpy as np

from labrig.simulation.description import LensDescription, LightDescription
from labrig.simulation.draw import coverage
from labrig.simulation.lens import Field32, Floats, Pose, pixel_plane, pixel_rays, project, rotation_about

_PAPER_WHITE = 1.15  # over clear gel
_PAPER_TURN_DEG = 0.2
_RULING = (
    (1, 0.12, 0.32),
    (5, 0.18, 0.50),
    (10, 0.26, 0.68),
)  # pitches between lines, width / pitch, darkness

_ANCHORS = ((-1, -1), (1, 1), (0, 0), (1, -1), (-1, 1), (0, -1), (1, 0), (0, 1), (-1, 0))
_FILLS = (0.97, 0.72, 0.86, 0.62, 0.78, 0.92, 0.55)
_RIM_SQUARES = 0.45  # white rim of the board, in squares
_CLEARANCE_PX = 3.0  # the board stays this far inside the picture
_BEHIND_BOARD = 0.30  # brightness of the background


def draw_light(light: LightDescription, lens: LensDescription) -> Field32:
    """Return the brightness of an even white surface over the picture (H, W), at most 1.

    It combines the lens's fall-off to the corners, a slope across the light table, and its lamp's broad spot.
    """
    u = np.arange(lens.width_px, dtype=np.float32)[None, :]
    v = np.arange(lens.height_px, dtype=np.float32)[:, None]
    a, b = (u - lens.cx_px) / lens.width_px, (v - lens.cy_px) / lens.width_px
    slope = -0.55 * a + 0.35 * b
    spot = np.exp(-((a - 0.12) ** 2 + (b + 0.05) ** 2) / 0.18)
    uneven = 1 - light.unevenness * (0.55 * (1 - spot) + 0.5 * (0.4 - slope) + 0.5 * (a**2 + b**2))
    return np.asarray(uneven / uneven.max(), np.float32)


def draw_graph_paper(
    pitch_mm: float, random: np.random.Generator, lens: LensDescription, white: Field32
) -> Field32:
    """Draw ruled paper that lies in the steering plane and fills the view, sharp, (H, W).

    The operator lays it along the sheath: its lines are turned by at most 0.2 degrees from the z axis and
    shifted at random. Every fifth line is heavier and every tenth heavier still.
    """
    plane = pixel_plane(lens)
    turn = math.radians(random.uniform(-_PAPER_TURN_DEG, _PAPER_TURN_DEG))
    shift_y, shift_z = random.uniform(0, 10 * pitch_mm, 2).astype(np.float32)
    across = plane.y_mm * math.cos(turn) - plane.z_mm * math.sin(turn) + shift_y
    along = plane.y_mm * math.sin(turn) + plane.z_mm * math.cos(turn) + shift_z
    ink = np.zeros_like(across)
    for pitches, width, darkness in _RULING:
        for place in (across, along):
            inside = np.float32(0.5 * width * pitch_mm) - _distance_to_line(place, pitches * pitch_mm)
            ink = np.maximum(ink, darkness * coverage(inside, plane.mm_per_px))
    return np.asarray(white * _PAPER_WHITE * (1 - ink), np.float32)


def _distance_to_line(place: Field32, every: float) -> Field32:
    """Return the distance to the nearest multiple of `every`."""
    return np.asarray(np.abs(place - every * np.rint(place / every)), np.float32)


@dataclass(frozen=True)
class Chessboard:
    """A chessboard: inner corners along each side, and the side of a square [mm]."""

    columns: int
    rows: int
    square_mm: float

    def rim_mm(self) -> Floats:
        """Return points (9, 2) around the card that the board is printed on."""
        half_x, half_y = ((cells + 1) / 2 + _RIM_SQUARES for cells in (self.columns, self.rows))
        return self.square_mm * np.array([(x * half_x, y * half_y) for x in (-1, 0, 1) for y in (-1, 0, 1)])


def draw_board(board: Chessboard, pose: Pose, lens: LensDescription, white: Field32) -> Field32:
    """Draw a chessboard at a pose, sharp, (H, W).

    Lens and pose are exact: each pixel's ray is intersected with the board's plane, and edges cover pixels in
    proportion to the distance of the pixel's centre. Depth of field is unlimited.
    """
    x, y = (flat / np.float32(board.square_mm) for flat in pose.intersect(pixel_rays(lens)))
    across, up = board.columns + 1, board.rows + 1
    inside = np.minimum(across / 2 - np.abs(x), up / 2 - np.abs(y))
    pixel = np.hypot(*np.gradient(x))
    chequers = _half_waves(x + across / 2, across) * _half_waves(y + up / 2, up)
    printed = 0.97 - 0.42 * (1 + chequers) * np.clip(inside / pixel + 0.5, 0, 1)
    card = np.clip((inside + _RIM_SQUARES) / pixel + 0.5, 0, 1)
    shading = 0.75 + 0.3 * abs(float(pose.rotation[2, 2]))
    return np.asarray(white * (_BEHIND_BOARD + card * (shading * printed - _BEHIND_BOARD)), np.float32)


def _half_waves(place: Field32, cells: int) -> Field32:
    """Return +1 in even cells and -1 in odd ones, with edges one pixel wide between them."""
    line = np.clip(np.rint(place), 1, cells - 1)
    pixel = np.abs(np.gradient(place, axis=0)) + np.abs(np.gradient(place, axis=1))
    return np.asarray((1 - 2 * (line % 2)) * np.clip(2 * (place - line) / pixel, -1, 1), np.float32)


def choose_board_pose(
    view: int, board: Chessboard, random: np.random.Generator, lens: LensDescription
) -> Pose:
    """Return the board's pose in a view: tilted by 18 to 40 degrees, and anywhere in the picture.

    The tilt's direction advances by the golden angle; size and place follow fixed cycles, with the hand's jitter.
    """
    direction = math.radians(137.508 * view + random.uniform(-15, 15))
    tilt = math.radians(18 + 22 * ((0.618034 * view + 0.5) % 1))
    spin = rotation_about(np.array([0.0, 0.0, 1.0]), math.radians(random.uniform(-10, 10)))
    lean = rotation_about(np.array([math.cos(direction), math.sin(direction), 0.0]), tilt)
    fill = _FILLS[view % len(_FILLS)] * random.uniform(0.96, 1.0)
    return _fit_pose(board.rim_mm(), lean @ spin, fill, _ANCHORS[view % len(_ANCHORS)], lens)


def _fit_pose(
    rim_mm: Floats, rotation: Floats, fill: float, anchor: tuple[int, int], lens: LensDescription
) -> Pose:
    """Return the pose at which the rim fills a share of the picture and is shifted towards the anchor."""
    size = np.array([lens.width_px, lens.height_px])
    pose = Pose(rotation, np.array([0.0, 0.0, 3 * np.ptp(rim_mm)]))
    for _ in range(30):
        pixels = project(pose.to_camera(rim_mm), lens)
        low, high = pixels.min(axis=0), pixels.max(axis=0)
        free = np.maximum(0.5 * (size - (high - low)) - _CLEARANCE_PX, 0)
        wanted = 0.5 * (size - 1) + np.array(anchor) * free
        depth = pose.translation_mm[2] * (1 + 0.7 * (float(((high - low) / size).max()) / fill - 1))
        sideways = pose.translation_mm[:2] + 0.8 * (wanted - 0.5 * (low + high)) * depth / lens.fx_px
        pose = Pose(rotation, np.array([*sideways, depth]))
    return pose
