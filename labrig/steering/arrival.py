"""Whether a needle has reached its target in space, from where its tip was seen and how uncertain that is.

The distance from the target is not normal: near the target the part that is not seen only adds to it. Its interval is
read from a fixed set of points that fills the normal distribution evenly, so that equal input gives equal digits.
"""

from functools import cache
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import ndtri

from labrig.errors import InputError
from labrig.needle.kinematics import FloatArray
from labrig.steering.tip import freeze, require_numbers

Arrival = Literal["reached", "reached_in_plane_only", "missed"]

_LEVELS = (0.025, 0.975)
_POINTS = 1 << 14
# The root of t^4 = t + 1. Fractions of multiples of its powers fill the unit cube evenly: M. Roberts, "The Unreasonable
# Effectiveness of Quasirandom Sequences" (2018).
_ROOT = 1.2207440846057596
_ASYMMETRY = 1e-9


def bound_target_error(offset_mm: ArrayLike, covariance_mm2: ArrayLike) -> tuple[float, float]:
    """Return the interval that holds the distance from the target with a probability of 95 %.

    Parameters
    ----------
    offset_mm : (3,) array
        The tip's expected place from the target, as (x, y, z).
    covariance_mm2 : (3, 3) array
        Of that place; zero for what is known.

    Returns
    -------
    (float, float)
        The 2.5th and the 97.5th percentile [mm].

    Raises
    ------
    InputError
        For another shape, a number that is not finite, or a matrix that is no covariance.
    """
    offset = require_numbers("offset_mm", offset_mm, (3,))
    covariance = require_numbers("covariance_mm2", covariance_mm2, (3, 3))
    variances, axes = np.linalg.eigh(covariance)
    scale = max(float(np.abs(covariance).max()), 1.0)
    if np.abs(covariance - covariance.T).max() > _ASYMMETRY * scale or variances[0] < -_ASYMMETRY * scale:
        raise InputError("covariance_mm2 is no covariance: it must be symmetric, without negative variances")
    places = offset + (_fill_normal() * np.sqrt(np.maximum(variances, 0.0))) @ axes.T
    low_mm, high_mm = np.quantile(np.linalg.norm(places, axis=1), _LEVELS)
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
    """Return points (N, 3) that fill the standard normal distribution of space evenly."""
    counts = np.arange(_POINTS, dtype=np.float64)[:, None]
    return freeze(ndtri((0.5 + counts * _ROOT ** -np.arange(1.0, 4.0)) % 1.0))
