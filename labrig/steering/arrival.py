"""Whether a needle has reached its target in space, from where its tip was seen and how uncertain that is.

The distance from the target is not normal: near the target every uncertainty only adds to it. A normal distribution
about the seen place takes all places of the plane for equally likely before, and so a distance for the likelier the
larger it is: its interval begins beyond a needle that was steered to its target. So before the picture every distance
at which the line of sight passes the target is equally likely here (the reference prior of a normal mean's length:
Berger, Philippe and Robert, "Estimation of quadratic functions", Statistica Sinica 8, 1998). What is out of the plane
keeps its distribution: a normal one, or several of which each holds with a probability. A needle that went farther
than was told is then in the tail, where a single normal distribution of the same variance has next to nothing.

The interval is read from a fixed set of points that fills the normal distribution evenly, so that equal input gives
equal digits.
"""

from dataclasses import dataclass, field
from functools import cache
from typing import Literal

import numpy as np
from scipy.special import ndtri

from labrig.needle.kinematics import FloatArray
from labrig.steering.tip import freeze

Arrival = Literal["reached", "reached_in_plane_only", "missed"]

_LEVELS = (0.025, 0.975)
# Distances below this share of the standard deviation are as likely as this.
_LEAST_SHARE = 0.01
_POINTS = 1 << 13
# The root of t^4 = t + 1. Fractions of multiples of its powers fill the unit cube evenly: M. Roberts, "The Unreasonable
# Effectiveness of Quasirandom Sequences" (2018).
_ROOT = 1.2207440846057596
_KNOWN_MM = 1e-9


@dataclass(frozen=True, eq=False)
class TipOffset:
    """The tip's place from the target as (x, y, z) [mm], x across the plane that the camera sees.

    Parameters
    ----------
    mm : (3,) array
    covariance_mm2 : (3, 3) array
        Zero for what is known.
    probability : float
        With which this place and its covariance hold.
    slope : (2,) array
        By how much y and z grow with x along the line of sight.
    """

    mm: FloatArray
    covariance_mm2: FloatArray
    probability: float = 1.0
    slope: FloatArray = field(default_factory=lambda: np.zeros(2))

    def spread(self) -> tuple[FloatArray, FloatArray]:
        """Return distances from the target (N,) [mm] and their probabilities (N,)."""
        variances, axes = np.linalg.eigh(self.covariance_mm2)
        x, y, z = (axes * np.sqrt(np.maximum(variances, 0.0))) @ _fill_normal() + self.mm[:, None]
        seen_mm = np.hypot(y - x * self.slope[0], z - x * self.slope[1])
        shares = 1.0 / np.maximum(seen_mm, _LEAST_SHARE * float(seen_mm.std()) + _KNOWN_MM)
        return np.sqrt(x**2 + y**2 + z**2), self.probability * shares / shares.sum()


def bound_target_error(*offsets: TipOffset) -> tuple[float, float]:
    """Return the 2.5th and the 97.5th percentile of the distance from the target [mm], of one or several offsets."""
    distances_mm, shares = (
        np.concatenate(parts) for parts in zip(*(offset.spread() for offset in offsets), strict=True)
    )
    order = np.argsort(distances_mm)
    total = np.cumsum(shares[order])
    low_mm, high_mm = np.interp(_LEVELS, total / total[-1], distances_mm[order])
    return float(low_mm), float(high_mm)


def decide_arrival(interval_mm: tuple[float, float], tolerance_mm: float) -> Arrival:
    """Return whether the target was reached.

    Parameters
    ----------
    interval_mm : (float, float)
        Of the distance from the target in space.
    tolerance_mm : float
        The largest distance that counts as reached.
    """
    if interval_mm[0] > tolerance_mm:
        return "missed"
    return "reached" if interval_mm[1] <= tolerance_mm else "reached_in_plane_only"


@cache
def _fill_normal() -> FloatArray:
    """Return points (3, N) that fill the standard normal distribution of space evenly."""
    return freeze(ndtri((0.5 + np.arange(_POINTS) * _ROOT ** -np.arange(1.0, 4.0)[:, None]) % 1.0))
