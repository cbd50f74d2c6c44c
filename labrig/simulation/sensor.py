"""The lens's blur and the sensor's noise."""

import cv2
import numpy as np
import numpy.typing as npt

from labrig.simulation.lens import Field32
from labrig.simulation.seeds import stream

BLUR_REACH_PX = 4
_BANK_RIM_PX = 256


def blur(sharp: Field32, blur_px: float) -> Field32:
    """Return the picture as the lens draws it: Gaussian, cut off at `BLUR_REACH_PX`."""
    if blur_px == 0:
        return sharp
    side = 2 * BLUR_REACH_PX + 1
    return np.asarray(cv2.GaussianBlur(sharp, (side, side), blur_px, borderType=cv2.BORDER_REFLECT_101))


class Sensor:
    """Photon and read-out noise from a bank that is drawn once; each picture takes another piece, mirrored at random.

    At the reference level half of the variance is read-out noise; the other half grows with the light.
    """

    def __init__(self, seed: int, size_px: tuple[int, int], noise_sd: float, level: float) -> None:
        width, height = size_px
        bank = (height + _BANK_RIM_PX, width + _BANK_RIM_PX)
        self._bank = stream(seed, "noise bank").standard_normal(bank, dtype=np.float32)
        self._size_px = size_px
        self._noise_sd = noise_sd
        self._level = level

    def expose(self, light: Field32, random: np.random.Generator) -> npt.NDArray[np.uint8]:
        """Return the picture (H, W) uint8 of the light (H, W) in grey levels."""
        width, height = self._size_px
        row, column = random.integers(0, _BANK_RIM_PX, 2)
        piece = self._bank[row : row + height, column : column + width]
        noise = cv2.flip(piece, int(random.integers(-1, 2)))
        variance = 0.5 * self._noise_sd**2
        deviation = cv2.addWeighted(light, variance / self._level, light, 0.0, variance)
        # In place: fresh memory of this size costs more than the arithmetic.
        cv2.sqrt(deviation, deviation)
        cv2.multiply(noise, deviation, noise)
        return np.asarray(cv2.add(light, noise, dtype=cv2.CV_8U), np.uint8)
