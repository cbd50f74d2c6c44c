"""Refraction at the gel's surface, by Snell's law.

The surface is assumed to be flat and parallel to the needle's plane, `depth_mm` nearer to the camera, with air above
it. Then only the camera's place above the plane matters: refraction changes nothing but the distance rho from the
camera's foot at which a ray reaches the plane.
"""

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from labrig.errors import InputError

PaperPlace = Literal["needle", "surface"]
_FloatArray = NDArray[np.float64]

_LARGEST_INDEX = 2.0
_MAX_NEWTON_STEPS = 30
_TOLERANCE_MM = 1e-10


@dataclass(frozen=True)
class Gel:
    """The gel between the camera and the needle.

    Attributes
    ----------
    index : float
        Refractive index; gelatin has about 1.34 to 1.36.
    depth_mm : float
        Depth of the needle below the gel's surface.
    paper : "needle" or "surface"
        Place of the graph paper, in air, at the plane calibration: that of the needle, or that of the gel's surface.
    """

    index: float
    depth_mm: float
    paper: PaperPlace = "needle"

    def __post_init__(self) -> None:
        if not 1.0 <= self.index <= _LARGEST_INDEX:
            raise InputError(
                f"the gel's index is {self.index}, and must be from 1 to {_LARGEST_INDEX:g}",
                "gelatin has about 1.35",
            )
        if not 0.0 <= self.depth_mm < np.inf:
            raise InputError(
                f"the gel's depth is {self.depth_mm} mm, and must be 0 or more",
                "measure from the gel's surface to the needle",
            )
        if self.paper not in get_args(PaperPlace):
            raise InputError(
                f"the paper cannot lie at {self.paper!r}", f"one of {', '.join(get_args(PaperPlace))}"
            )

    def assumptions(self) -> tuple[str, ...]:
        """Return the assumptions of the correction, a sentence each."""
        where = (
            f"where the needle was to be, {self.depth_mm:g} mm below the place of the gel's surface"
            if self.paper == "needle"
            else f"on the gel's surface, {self.depth_mm:g} mm above the needle"
        )
        return (
            f"The graph paper lay in air {where}.",
            "The gel's surface is flat and parallel to the paper, and nothing but air lies above it.",
            f"The gel's refractive index is {self.index:g} throughout.",
        )

    def bend(self, straight_mm: _FloatArray, camera_mm: _FloatArray) -> _FloatArray:
        """Return where rays reach the needle's plane (N, 2) [mm] that would reach the paper's plane at `straight_mm`.

        `camera_mm` is the camera's foot (y, z) on the paper's plane and its height.
        """
        aside = straight_mm - camera_mm[:2]
        return np.asarray(camera_mm[:2] + aside * self._stretch(_length(aside), camera_mm[2])[:, None])

    def straighten(self, bent_mm: _FloatArray, camera_mm: _FloatArray) -> _FloatArray:
        """Return where the rays would reach the paper's plane (N, 2) [mm] without refraction: the inverse of `bend`."""
        aside = bent_mm - camera_mm[:2]
        wanted = _length(aside)
        found = wanted.copy()
        for _ in range(_MAX_NEWTON_STEPS):
            missing = wanted - found * self._stretch(found, camera_mm[2])
            # The stretch hardly changes with the distance, so dividing by it is nearly Newton's step.
            found = found + missing / self._stretch(found, camera_mm[2])
            if np.abs(missing).max(initial=0.0) <= _TOLERANCE_MM:
                break
        return np.asarray(camera_mm[:2] + aside * (found / np.maximum(wanted, np.finfo(float).tiny))[:, None])

    def _stretch(self, distance_mm: _FloatArray, height_mm: float) -> _FloatArray:
        """Return the factors (N,) by which refraction stretches distances from the camera's foot."""
        slope = distance_mm / height_mm
        # sin b = sin a / n, written with tangents.
        inner = 1.0 / np.sqrt(self.index**2 * (1.0 + slope**2) - slope**2)
        share = self.depth_mm / height_mm
        return np.asarray(1.0 + share * (inner - (1.0 if self.paper == "needle" else 0.0)))


def _length(points: _FloatArray) -> _FloatArray:
    return np.asarray(np.hypot(points[:, 0], points[:, 1]))
