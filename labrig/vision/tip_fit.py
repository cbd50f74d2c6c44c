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
Point = tuple[float, float]

# A step that moves no pixel of the template by more than this ends the search [px]: in a robust fit a hundredth of the
# error of a tip, in the other one, from which the robust one starts, a tenth of a pixel. A search that needs more than
# this number of steps does not converge.
_SETTLED_PX, _ROUGHLY_PX, _STEPS = 0.001, 0.1, 40
_BLUR_PX = 1.0
# Tukey's constant, for 95 % efficiency with normal noise. The assumed noise falls from step to step, from the residual
# of a fit half a pixel off to little more than a camera's noise [grey levels], the last.
_TUKEY, _NOISES = 4.685, (10.0, 6.0, 4.0)


@dataclass(frozen=True)
class Placement:
    """A map from pixels of a template, relative to a pivot, to pixels of a picture.

    lands_px : (float, float)
        Where the pivot is (u, v).
    turn_rad : float
        Positive counter-clockwise on the screen.
    """

    lands_px: Point
    turn_rad: float

    def rotation(self) -> FloatArray:
        """Return the (2, 2) turn of offsets from the pivot."""
        c, s = math.cos(self.turn_rad), math.sin(self.turn_rad)
        return np.array([[c, s], [-s, c]])

    def shift(self, right_px: float, down_px: float) -> "Placement":
        """Return this map into a picture whose first pixel lies elsewhere."""
        return Placement((self.lands_px[0] + right_px, self.lands_px[1] + down_px), self.turn_rad)

    def step_back(self, step: FloatArray) -> "Placement":
        """Return this map after the inverse of a small step: shift (2) in the template's pixels, and turn."""
        turned = Placement(self.lands_px, self.turn_rad - float(step[2]))
        return turned.shift(*(-(turned.rotation() @ step[:2])).tolist())


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
    pivot_px: Point
    used: NDArray[np.bool_]
    robust: bool

    @cached_property
    def _offsets_px(self) -> FloatArray:
        """The used pixels from the pivot (2, N), rows right and down."""
        v, u = np.nonzero(self.used)
        return np.array((u - self.pivot_px[0], v - self.pivot_px[1]))

    @cached_property
    def _columns(self) -> FloatArray:
        """The regressors (N, 5): steepest descents of shift and turn, the template, a constant."""
        smooth = _blur(self.picture)
        across, down = (
            cv2.Sobel(smooth, cv2.CV_64F, right, 1 - right, scale=0.125)[self.used] for right in (1, 0)
        )
        right, below = self._offsets_px
        turned = across * below - down * right
        return np.column_stack((across, down, turned, smooth[self.used], np.ones_like(across)))

    @cached_property
    def _inverse(self) -> FloatArray:
        """The pseudo-inverse (5, N) of the regressors."""
        return np.asarray(np.linalg.pinv(self._columns))

    @cached_property
    def _brightness(self) -> FloatArray:
        """The pseudo-inverse (2, N) of the template and the constant alone."""
        return np.asarray(np.linalg.pinv(self._columns[:, 3:]))

    def fit(self, picture: Picture, start: Placement) -> Placement | None:
        """Return the best place near a start; None if the fit does not converge.

        Parameters
        ----------
        picture : ndarray of uint8, (H, W)
        start : Placement
            Within about a tenth of the template's side and ten degrees.
        """
        smooth, place = _blur(picture), start
        reach_px = 0.5 * max(self.picture.shape)
        settled_px, first = (_SETTLED_PX, len(_NOISES)) if self.robust else (_ROUGHLY_PX, 0)
        for number in range(_STEPS):
            u, v = place.lands_px
            if not (0 <= u < smooth.shape[1] and 0 <= v < smooth.shape[0]):
                return None
            seen = self._sample(smooth, place)
            found = self._regress(seen, number) if self.robust else self._inverse @ seen
            if found[3] <= 0.0:
                return None
            step = found[:3] / found[3]
            place = place.step_back(step)
            if math.hypot(step[0], step[1]) + reach_px * abs(step[2]) < settled_px and number >= first:
                return place
        return None

    def correlate(self, picture: Picture, place: Placement) -> float:
        """Return the correlation of the template with a picture at a place."""
        seen = self._sample(_blur(picture), place)
        return float(np.nan_to_num(np.corrcoef(seen, self._columns[:, 3])[0, 1]))

    def _sample(self, smooth: FloatArray, place: Placement) -> FloatArray:
        """Return the grey levels (N,) under the used pixels; the picture's rim repeats itself outwards.

        OpenCV's own warp rounds places to a thirty-second of a pixel, so that a fit cannot converge more closely.
        """
        columns, rows = place.rotation() @ self._offsets_px + np.array(place.lands_px)[:, None]
        return np.asarray(map_coordinates(smooth, (rows, columns), order=1, mode="nearest"))

    def _regress(self, seen: FloatArray, number: int) -> FloatArray:
        """Return the coefficients (5,) of grey levels (N,) where pixels that do not fit have lost their weight."""
        off = seen - self._columns[:, 3:] @ (self._brightness @ seen)
        noise = _NOISES[min(number, len(_NOISES) - 1)]
        weights = np.square(np.maximum(1.0 - np.square(off / (_TUKEY * noise)), 0.0))
        weighted = self._columns * weights[:, None]
        return np.asarray(np.linalg.solve(weighted.T @ self._columns, weighted.T @ seen))


def _blur(picture: Picture) -> FloatArray:
    return np.asarray(cv2.GaussianBlur(picture.astype(np.float64), (0, 0), _BLUR_PX))
