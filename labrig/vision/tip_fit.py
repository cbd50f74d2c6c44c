"""A template fitted to a picture: shift and turn by least squares, for any brightness and contrast.

The inverse compositional form (Baker and Matthews 2004, International Journal of Computer Vision 56:221) of what
enhanced correlation maximises (Evangelidis and Psarakis 2008, IEEE TPAMI 30:1858): each step regresses the picture on
the template, its steepest descents and a constant. A robust fit takes the weight from pixels that do not fit the rest
(Tukey's biweight): a glint stays where the lamp puts it while the needle turns.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from labrig.vision.picture import Picture

FloatArray = NDArray[np.float64]

# A step that moves no pixel of the template by more than this ends the search [px]: a hundredth of the error of a tip.
# A search that needs more than this number of steps does not converge.
_SETTLED_PX, _STEPS = 0.001, 40
_BLUR_PX = 1.0
# Tukey's constant, for 95 % efficiency with normal noise. The assumed noise falls from step to step, from the residual
# of a fit half a pixel off to little more than a camera's noise [grey levels], the last.
_TUKEY, _NOISES = 4.685, (10.0, 6.0, 4.0)


@dataclass(frozen=True)
class Placement:
    """A map from pixels of a template, relative to a pivot, to pixels of a picture."""

    lands_px: tuple[float, float]
    turn_rad: float

    def warp(self, pivot_px: tuple[float, float], scale: float) -> FloatArray:
        """Return the (2, 3) map of the template's pixels; a positive turn is counter-clockwise on the screen."""
        turn = scale * _rotation(self.turn_rad)
        u, v = np.asarray(self.lands_px) - turn @ pivot_px
        return np.array(((turn[0, 0], turn[0, 1], u), (turn[1, 0], turn[1, 1], v)))

    def apply(self, offsets_px: FloatArray) -> FloatArray:
        """Return pixels (N, 2) of the picture of offsets from the pivot."""
        return np.asarray(offsets_px @ _rotation(self.turn_rad).T + self.lands_px)

    def step_back(self, step: FloatArray) -> "Placement":
        """Return this map after the inverse of a small step: shift (2) in the template's pixels, and turn."""
        turn_rad = self.turn_rad - float(step[2])
        u, v = np.asarray(self.lands_px) - _rotation(turn_rad) @ step[:2]
        return Placement((float(u), float(v)), turn_rad)


@dataclass(frozen=True, eq=False)
class FitTemplate:
    """A template prepared for fitting.

    Parameters
    ----------
    picture : ndarray of uint8, (H, W)
    pivot_px : (float, float)
        The pixel to locate.
    used : ndarray of bool, (H, W)
        Pixels to compare.
    robust : bool
        Whether pixels that do not fit the rest lose their weight.
    """

    picture: Picture
    pivot_px: tuple[float, float]
    used: NDArray[np.bool_]
    robust: bool

    @cached_property
    def _offsets_px(self) -> FloatArray:
        """The used pixels from the pivot (N, 2), columns right and down."""
        v, u = np.nonzero(self.used)
        return np.asarray(np.column_stack((u, v)) - self.pivot_px)

    @cached_property
    def _columns(self) -> FloatArray:
        """The regressors (N, 5): steepest descents of shift and turn, the template, a constant."""
        smooth = _blur(self.picture)
        across, down = (
            cv2.Sobel(smooth, cv2.CV_64F, right, 1 - right, scale=0.125)[self.used] for right in (1, 0)
        )
        right, below = self._offsets_px.T
        return np.column_stack(
            (
                across,
                down,
                across * below - down * right,
                smooth[self.used],
                np.ones_like(across),
            )
        )

    @cached_property
    def _normal(self) -> FloatArray:
        """The normal matrix (5, 5) with full weight for every pixel."""
        return np.asarray(self._columns.T @ self._columns)

    def fit(self, picture: Picture, start: Placement) -> Placement | None:
        """Return the best place near a start; None if the fit does not converge or leaves the picture.

        Parameters
        ----------
        picture : ndarray of uint8, (H, W)
        start : Placement
            Within about a tenth of the template's side and ten degrees.
        """
        smooth, place = _blur(picture), start
        reach = 0.5 * max(self.picture.shape)
        for number in range(_STEPS):
            seen = self._sample(smooth, place)
            if seen is None:
                return None
            step = self._step(seen, number)
            if step is None:
                return None
            place = place.step_back(step)
            moved_px = math.hypot(step[0], step[1]) + reach * abs(step[2])
            if moved_px < _SETTLED_PX and number >= len(_NOISES):
                return place
        return None

    def score(self, picture: Picture, place: Placement) -> float:
        """Return the correlation of the template with a picture at a place."""
        seen = self._sample(_blur(picture), place)
        if seen is None:
            return 0.0
        gain, _ = self._brightness(seen @ self._columns[:, 3:])
        return self._correlation(seen, gain)

    def _step(self, seen: FloatArray, number: int) -> FloatArray | None:
        """Return the step (3,) that moves the template closer to the picture; None if the picture does not show it."""
        right = seen @ self._columns
        gain, offset = self._brightness(right[3:])
        if gain <= 0.0:
            return None
        normal = self._normal
        if self.robust:
            weighted = self._columns * self._weights(seen, gain, offset, number)[:, None]
            normal, right = weighted.T @ self._columns, seen @ weighted
        found = np.linalg.solve(normal, right)
        return found[:3] / found[3] if found[3] > 0.0 else None

    def _brightness(self, right: FloatArray) -> tuple[float, float]:
        """Return gain and offset of the grey levels, from their products with the template and with a constant."""
        (squares, total), (_, pixels) = self._normal[3:, 3:].tolist()
        gain = float(pixels * right[0] - total * right[1]) / (pixels * squares - total**2)
        return gain, (float(right[1]) - gain * total) / pixels

    def _correlation(self, seen: FloatArray, gain: float) -> float:
        """Return the correlation with the template from the regression's slope `gain`."""
        pixels, total = self._normal[4, 4], self._normal[3, 4]
        spread = self._normal[3, 3] - total**2 / pixels
        seen_spread = float(seen.var()) * pixels
        return gain * math.sqrt(spread / seen_spread) if seen_spread > 0.0 else 0.0

    def _weights(self, seen: FloatArray, gain: float, offset: float, number: int) -> FloatArray:
        """Return the weight (N,) of each pixel from its distance to the template's grey level."""
        off = seen - (gain * self._columns[:, 3] + offset)
        noise = _NOISES[min(number, len(_NOISES) - 1)]
        return np.square(np.maximum(1.0 - np.square(off / (_TUKEY * noise)), 0.0))

    def _sample(self, smooth: FloatArray, place: Placement) -> FloatArray | None:
        """Return the grey levels (N,) under the template; None if its pivot is outside the picture.

        OpenCV's own warp rounds places to a thirty-second of a pixel, so that a fit cannot converge more closely.
        """
        u, v = place.lands_px
        if not (0 <= u < smooth.shape[1] and 0 <= v < smooth.shape[0]):
            return None
        columns, rows = place.apply(self._offsets_px).T
        return np.asarray(map_coordinates(smooth, (rows, columns), order=1, mode="nearest"))


def _rotation(turn_rad: float) -> FloatArray:
    c, s = math.cos(turn_rad), math.sin(turn_rad)
    return np.array([[c, s], [-s, c]])


def _blur(picture: Picture) -> FloatArray:
    return np.asarray(cv2.GaussianBlur(picture.astype(np.float64), (0, 0), _BLUR_PX))
