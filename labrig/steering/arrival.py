"""Whether a needle has reached its target in space, from where its tip was seen and how uncertain that is.

The distance from the target is not normal: near the target every uncertainty only adds to it. A normal distribution
about the seen place takes all places of the plane for equally likely before, and so a distance for the likelier the
larger it is: its interval begins beyond a needle that was steered to its target. So before the picture every distance
at which the line of sight passes the target is equally likely here (the reference prior of a normal mean's length:
Berger, Philippe and Robert, "Estimation of quadratic functions", Statistica Sinica 8, 1998). What is out of the plane
keeps its distribution.

The interval is read from a fixed set of points that fills the normal distribution evenly, so that equal input gives
equal digits.
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
# Distances below this share of the standard deviation are as likely as this.
_LEAST_SHARE = 0.01
_POINTS = 1 << 14
# The root of t^4 = t + 1. Fractions of multiples of its powers fill the unit cube evenly: M. Roberts, "The Unreasonable
# Effectiveness of Quasirandom Sequences" (2018).
_ROOT = 1.2207440846057596
_ASYMMETRY = 1e-9
_KNOWN_MM = 1e-9


def bound_target_error(offset_mm: ArrayLike, covariance_mm2: ArrayLike) -> tuple[float, float]:
    """Return the interval that holds the distance from the target with a probability of 95 %.

    Parameters
    ----------
    offset_mm : (3,) array
        The tip's place from the target as (x, y, z), x across the plane that the camera sees.
    covariance_mm2 : (3, 3) array
        Of that place; zero for what is known. Where y and z vary with x, they do so along the line of sight.

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
    ray = covariance[1:, 0] / covariance[0, 0] if covariance[0, 0] > 0.0 else np.zeros(2)
    seen_mm = np.linalg.norm(places[:, 1:] - places[:, :1] * ray, axis=1)
    least_mm = _LEAST_SHARE * float(seen_mm.std()) + _KNOWN_MM
    distances_mm = np.linalg.norm(places, axis=1)
    order = np.argsort(distances_mm, kind="stable")
    shares = np.cumsum(1.0 / np.maximum(seen_mm[order], least_mm))
    low_mm, high_mm = np.interp(_LEVELS, shares / shares[-1], distances_mm[order])
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
