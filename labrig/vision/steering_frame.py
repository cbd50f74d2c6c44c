"""The steering plane frame on ruled paper: its origin at a pixel, +z along the lines nearest to the insertion."""

import numpy as np
from numpy.typing import NDArray

from labrig.vision.plane import PICTURE_AXES, Insertion, apply_homography

_FloatArray = NDArray[np.float64]


class SteeringFrame:
    """The steering plane frame: `origin` (1, 2) in ideal pixels, +z along the lines nearest to the insertion.

    The fitted homography decides once which lines these are; its variations share that frame.
    """

    def __init__(self, origin: _FloatArray, insertion: Insertion, homography: _FloatArray) -> None:
        self._origin = origin
        place = apply_homography(homography, origin)[0]
        ahead = apply_homography(np.linalg.inv(homography), place + 1e-3 * np.eye(2)) - origin
        lines = ahead / np.linalg.norm(ahead, axis=1)[:, None]
        # Cosines in the picture between +y, +z (rows) and the paper's two axes (columns).
        along = np.array(PICTURE_AXES[insertion], dtype=np.float64) @ lines.T
        z_line = int(np.argmax(np.abs(along[1])))
        self.turn = np.zeros((2, 2))
        for row, line in ((0, 1 - z_line), (1, z_line)):
            self.turn[row, line] = np.sign(along[row, line])
        self.turn_rad = float(np.arccos(np.clip(np.abs(along[1, z_line]), 0.0, 1.0)))

    def transform(self, homography: _FloatArray) -> _FloatArray:
        """Return the homography from ideal pixels to the frame."""
        change = np.eye(3)
        change[:2, :2] = self.turn
        change[:2, 2] = -self.turn @ apply_homography(homography, self._origin)[0]
        return np.asarray(change @ homography)
