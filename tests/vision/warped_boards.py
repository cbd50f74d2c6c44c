"""Corners of a warped board in random poses, for tests and benchmarks of the lens calibration.

Independent of `labrig`: the projection is written out here, and the board's shape is given as a function of its
points, so a mistake in the code under test is not repeated.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
Shape = Callable[[FloatArray, FloatArray], FloatArray]

_MARGIN_PX = 5.0


@dataclass(frozen=True)
class SimulatedCamera:
    """A pinhole with two radial and two tangential coefficients."""

    size: tuple[int, int] = (1280, 720)
    fx: float = 1100.0
    fy: float = 1102.0
    cx: float = 645.0
    cy: float = 352.0
    k1: float = -0.15
    k2: float = 0.06
    p1: float = 4e-4
    p2: float = -3e-4

    def project(self, points: FloatArray) -> FloatArray:
        """Return the pixels (N, 2) of points (N, 3) before the camera [mm]."""
        x, y = (points[:, :2] / points[:, 2:]).T
        s = x**2 + y**2
        radial = 1.0 + self.k1 * s + self.k2 * s**2
        u = x * radial + 2.0 * self.p1 * x * y + self.p2 * (s + 2.0 * x**2)
        v = y * radial + self.p1 * (s + 2.0 * y**2) + 2.0 * self.p2 * x * y
        return np.column_stack((self.fx * u + self.cx, self.fy * v + self.cy))


@dataclass(frozen=True)
class SimulatedBoard:
    """A board whose height towards the camera [mm] is a function of its points, each from -1 to 1 over the board."""

    columns: int = 9
    rows: int = 6
    square_mm: float = 25.0
    height_mm: Shape = lambda x, y: 0.0 * x

    @property
    def points_mm(self) -> FloatArray:
        """Corners of the flat board (N, 2)."""
        y, x = np.mgrid[: self.rows, : self.columns] * self.square_mm
        return np.column_stack((x.ravel(), y.ravel()))

    def bent_mm(self) -> FloatArray:
        """Corners of the real board (N, 3) about its middle; z points away from the camera."""
        half = 0.5 * self.square_mm * np.array([self.columns - 1, self.rows - 1])
        flat = self.points_mm - half
        x, y = (flat / half).T
        return np.column_stack((flat, -self.height_mm(x, y)))


def parabolas(row_mm: float, column_mm: float) -> Shape:
    """Return a board whose middle stands so far above the ends of its middle row and column."""
    return lambda x, y: row_mm * (1.0 - x**2) + column_mm * (1.0 - y**2)


def draw_views(
    camera: SimulatedCamera,
    board: SimulatedBoard,
    count: int,
    random: np.random.Generator,
    *,
    noise_px: float = 0.15,
    tilt_deg: float = 45.0,
) -> list[FloatArray]:
    """Return the pixels of the corners in `count` poses in which the whole board is seen."""
    views: list[FloatArray] = []
    while len(views) < count:
        seen = camera.project(_pose(board.bent_mm(), board, random, np.deg2rad(tilt_deg)))
        if (seen > _MARGIN_PX).all() and (seen < np.array(camera.size) - _MARGIN_PX).all():
            views.append(seen + random.normal(0.0, noise_px, seen.shape))
    return views


def _pose(
    points: FloatArray, board: SimulatedBoard, random: np.random.Generator, largest_rad: float
) -> FloatArray:
    """Return points (N, 3) tilted by up to `largest_rad` about a random axis, rolled a little, and shifted."""
    length = board.square_mm * board.columns
    way, tilt, roll = (
        random.uniform(0.0, 2.0 * np.pi),
        random.uniform(0.0, largest_rad),
        random.normal(0.0, 0.2),
    )
    turn = _rotate_z(way) @ _rotate_x(tilt) @ _rotate_z(roll - way)
    shift = length * np.array(
        [random.uniform(-0.4, 0.4), random.uniform(-0.25, 0.25), random.uniform(1.0, 1.8)]
    )
    return np.asarray(points @ turn.T + shift)


def _rotate_x(angle: float) -> FloatArray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


def _rotate_z(angle: float) -> FloatArray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
