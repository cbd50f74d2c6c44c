"""The warp of a calibration board that is not flat.

A printed board on a plate is bent by tenths of a millimetre. A fit that takes it for flat changes the focal length
instead: of twelve views of a board 200 mm long, a warp of 0.3 mm puts it off by eight stated standard deviations. So
the height of the board is a parabola along its rows plus one along its columns, as in mrcal, and both are fitted with
the camera. A view may show a part of the board at an unknown place, because a shifted parabola differs from the first
one by a tilt alone. A board as wide as high may also be seen turned by 90 degrees, so its two parabolas are taken to
be equal. A twist of the board is not in the model, nor in mrcal's: one of 0.3 mm makes the error of fx 4.4 times
larger. The scatter between views shows it (`lens_fit`): the stated deviation is 1.13 of the actual error over 200 sets
of twelve views.

Before the views are seen, each height is zero within 1.5 mm per metre of the board's diagonal, one standard deviation.
Where the views cannot tell it, it stays there, and this deviation is in the uncertainty of the lens.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

_FloatArray = NDArray[np.float64]

_PRIOR_PER_DIAGONAL = 1.5e-3
# The views tell the warp if they reduce its standard deviation to this share.
_TOLD = 0.5


@dataclass(frozen=True)
class BoardWarp:
    """How far the middle of the board stands above its edges, towards the camera, along its rows and its columns.

    Attributes
    ----------
    row_mm, column_mm : float
        Height of the middle of a row over its ends, and of the middle of a column over its ends.
    sigma_row_mm, sigma_column_mm : float
        Their standard deviations.
    prior_mm : float
        The standard deviation of both before the views are seen.
    """

    row_mm: float
    column_mm: float
    sigma_row_mm: float
    sigma_column_mm: float
    prior_mm: float

    def sentence(self) -> str:
        """Return the warp in words."""
        heights = (
            f"the middle of its rows stands {self.row_mm:+z.3f} ± {self.sigma_row_mm:.3f} mm, that of its columns "
            f"{self.column_mm:+z.3f} ± {self.sigma_column_mm:.3f} mm towards the camera (1 sigma)"
        )
        if max(self.sigma_row_mm, self.sigma_column_mm) <= _TOLD * self.prior_mm:
            return f"Warp of the board: {heights}."
        return (
            f"The views hardly tell the warp of the board: {heights}. It is taken to be within {self.prior_mm:.3f} mm "
            "(1 sigma), which is in the uncertainty of the lens; more tilted views would tell it."
        )


@dataclass(frozen=True, eq=False)
class WarpModel:
    """The parabolas of a board.

    Attributes
    ----------
    middle_mm, half_mm : ndarray (2,)
        Middle of all corners, and half the length of the largest view along rows and columns.
    prior_mm : float
        Standard deviation of a height before the views are seen.
    """

    middle_mm: _FloatArray
    half_mm: _FloatArray
    prior_mm: float

    @classmethod
    def of_boards(cls, boards_mm: Sequence[_FloatArray]) -> "WarpModel":
        """Return the model for a board of which each view shows some corners (N, 2)."""
        corners = np.vstack(boards_mm)
        middle = 0.5 * (corners.min(axis=0) + corners.max(axis=0))
        half = 0.5 * np.max([np.ptp(board, axis=0) for board in boards_mm], axis=0)
        prior = 2.0 * _PRIOR_PER_DIAGONAL * float(np.hypot(*half))
        return cls(middle, half, prior)

    def shapes(self, board_mm: _FloatArray) -> _FloatArray:
        """Return the heights (N, W) [mm] of corners (N, 2) along z, for one prior deviation of each parabola."""
        parabolas = self.prior_mm * (1.0 - ((board_mm - self.middle_mm) / self.half_mm) ** 2)
        may_turn = np.isclose(self.half_mm[0], self.half_mm[1])
        return np.asarray(parabolas.sum(axis=1, keepdims=True) if may_turn else parabolas)

    def describe(self, warp: _FloatArray, sigma: _FloatArray, *, away: bool) -> BoardWarp:
        """Return the fitted warp [prior deviations] in mm; `away` if z of the board points away from the camera."""
        row, column = np.broadcast_to((-1.0 if away else 1.0) * self.prior_mm * warp, 2)
        sigma_row, sigma_column = np.broadcast_to(self.prior_mm * sigma, 2)
        return BoardWarp(float(row), float(column), float(sigma_row), float(sigma_column), self.prior_mm)
