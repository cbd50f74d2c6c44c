"""Draws a needle that leaves the plane, as a pinhole camera sees it; shares nothing with labrig.

The plane is 10 px/mm, z to the right and y up, with the sheath's tip at (0, 0). A point at (x, y, z) is seen at the
foot of the camera plus D / (D + x) of its distance from there, and so reduced.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

PX_PER_MM, ORIGIN_PX, SIZE_PX = 10.0, (150.0, 160.0), (1300, 220)
FOOT_MM, CAMERA_MM = (0.0, 50.0), 185.0
NEEDLE_MM, SHEATH_MM = 1.2, 2.0
GEL, STEEL = 175.0, 60.0
STEP_MM = 0.05

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class DeepNeedle:
    """A needle in two bends, whose end is x_mm behind the plane; `rough` is the relative scatter of its width."""

    length_mm: float = 100.0
    x_mm: float = 0.0
    rough: float = 0.0
    seed: int = 1

    def draw(self) -> NDArray[np.uint8]:
        """Return the picture."""
        random = np.random.default_rng(self.seed)
        arc = np.arange(0.0, self.length_mm, STEP_MM)
        share = arc / self.length_mm
        x_mm = self.x_mm * share**2 * (3 - share) / 2
        heading = 0.25 * np.sin(2 * np.pi * share)
        lean = np.gradient(x_mm, STEP_MM)
        along = STEP_MM * np.sqrt(1 - lean**2)
        places = np.column_stack((np.cumsum(along * np.sin(heading)), np.cumsum(along * np.cos(heading))))
        scale = CAMERA_MM / (CAMERA_MM + x_mm)
        seen = FOOT_MM + scale[:, None] * (places - FOOT_MM)
        width = (
            NEEDLE_MM
            * scale
            * (1 + self.rough * random.standard_normal(len(arc) // 60 + 1)[(arc / 3).astype(int)])
        )
        grey = np.full(SIZE_PX[::-1], GEL)
        _paint(grey, seen, width)
        behind = np.arange(-ORIGIN_PX[0] / PX_PER_MM - 1, 0.0, STEP_MM)
        _paint(grey, np.column_stack((np.zeros(len(behind)), behind)), np.full(len(behind), SHEATH_MM))
        grey = cv2.GaussianBlur(grey, (0, 0), 0.8) + random.normal(0.0, 2.0, grey.shape)
        return np.clip(grey, 0, 255).astype(np.uint8)


def _paint(grey: Floats, line_mm: Floats, width_mm: Floats) -> None:
    """Darken the pixels within half the width of a line."""
    line_px = np.column_stack(
        (ORIGIN_PX[0] + PX_PER_MM * line_mm[:, 1], ORIGIN_PX[1] - PX_PER_MM * line_mm[:, 0])
    )
    pixels = np.argwhere(np.ones(grey.shape))[:, ::-1]
    found = cKDTree(line_px).query(pixels, distance_upper_bound=20.0)
    apart, nearest = (np.asarray(part) for part in found)
    near = np.isfinite(apart)
    covered = np.clip(0.5 * PX_PER_MM * width_mm[nearest[near]] - apart[near] + 0.5, 0.0, 1.0)
    flat = grey.reshape(-1)
    flat[near] += covered * (STEEL - flat[near])
