"""The torsional lag of a needle, from bends at right angles to the plane that were turned to from either side.

A bevel that was turned to 90 degrees from below stands at 90 - h, from above at 90 + h. In the plane the needle then
bends by -sin(h) / r and +sin(h) / r. Half the difference of the two deflections gives h. Everything that does not
depend on the direction cancels: the roll zero's error, parallax of a needle that leaves the plane, and the swing of the
hinges but for its delay.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares
from scipy.special import ndtri, stdtrit

from labrig.errors import InputError, MeasurementRefusedError
from labrig.needle.kinematics import FloatArray
from labrig.steering.torsion import TorsionalLag

_LEAST_DEPTHS = 2
# Radius and lags beyond which a fit means nothing.
_RADIUS_FACTOR = 1.5
_LARGEST_LAG_RAD = math.radians(75.0)


@dataclass(frozen=True)
class TorsionBend:
    """What one hole shows.

    Parameters
    ----------
    depth_mm : float
        Length of needle in the gel at the turn to 90 degrees.
    direction : int
        1: turned to from below, -1: from above.
    bent_from_mm : float
        Depth of the last turn before, to the roll zero.
    bent_mm, turned_mm : float
        Lateral deflections, towards +y across the heading at their start: at the roll zero before the turn, and
        after it.
    """

    depth_mm: float
    direction: int
    bent_from_mm: float
    bent_mm: float
    turned_mm: float


@dataclass(frozen=True)
class BendLengths:
    """Inserted lengths of the two deflections, and the backlash of the hinges: a turn acts half of it later."""

    bent_mm: float
    turned_mm: float
    backlash_mm: float


@dataclass(frozen=True)
class TorsionFit:
    """The lag of the bevel on either side of its base.

    Attributes
    ----------
    lag : TorsionalLag
        Its standard deviations are widened so that 1.96 of them make an interval of 95 % by Student's t.
    sd_rad : float
        The largest standard deviation of the lag between the sheath and the deepest turn.
    radius_mm : float
        Of the needle's arcs.
    residual_rms_mm : float
    """

    lag: TorsionalLag
    sd_rad: float
    radius_mm: float
    residual_rms_mm: float


def fit_torsion(bends: Sequence[TorsionBend], lengths: BendLengths, radius_mm: float) -> TorsionFit:
    """Return the lag that grows linearly with the depth, by least squares with first-order propagation.

    Parameters
    ----------
    bends : sequence of TorsionBend
        At two depths or more, at each of them from both sides.
    lengths : BendLengths
    radius_mm : float
        Expected radius.

    Raises
    ------
    InputError
        For fewer bends.
    MeasurementRefusedError
        If the needle bends otherwise than expected.
    """
    depths_mm = _list_depths_mm(bends)
    # It starts without a lag, at the expected radius and the mean deflection at each depth.
    means_mm = [np.mean([bend.turned_mm for bend in bends if bend.depth_mm == depth]) for depth in depths_mm]
    guess = np.array((0.0, 0.0, radius_mm, *means_mm))
    solved = least_squares(_find_residuals, guess, args=(bends, depths_mm, lengths), method="lm")
    lag_rad, per_mm, radius = (float(value) for value in solved.x[:3])
    _refuse_unexpected(radius, radius_mm, lag_rad, lag_rad + per_mm * depths_mm[-1])
    residuals, slopes = np.asarray(solved.fun), np.asarray(solved.jac)
    freedom = len(residuals) - slopes.shape[1]
    scatter_mm2 = float(residuals @ residuals) / freedom * float(stdtrit(freedom, 0.975) / ndtri(0.975)) ** 2
    covariance = scatter_mm2 * np.linalg.inv(slopes.T @ slopes)[:2, :2]
    best_mm = -covariance[0, 1] / covariance[1, 1]
    best_rad2 = covariance[0, 0] + best_mm * covariance[0, 1]
    lag = TorsionalLag(
        lag_rad, per_mm, float(best_mm), math.sqrt(max(best_rad2, 0.0)), math.sqrt(covariance[1, 1])
    )
    return TorsionFit(
        lag=lag,
        sd_rad=max(lag.find_sd_rad(at_mm) for at_mm in (0.0, depths_mm[-1])),
        radius_mm=radius,
        residual_rms_mm=math.sqrt(float(np.mean(residuals**2))),
    )


def _list_depths_mm(bends: Sequence[TorsionBend]) -> list[float]:
    """Return the depths, from the least; refuse bends at fewer than two, or not from both sides."""
    depths_mm = sorted({bend.depth_mm for bend in bends})
    if len(depths_mm) < _LEAST_DEPTHS or {(bend.depth_mm, bend.direction) for bend in bends} != {
        (depth_mm, direction) for depth_mm in depths_mm for direction in (-1, 1)
    }:
        raise InputError(
            f"the torsion was measured at {len(depths_mm)} depths, two are the least, each from both sides",
            "measure again at each depth",
        )
    return depths_mm


def _refuse_unexpected(radius_mm: float, expected_mm: float, lag_rad: float, deepest_rad: float) -> None:
    """Refuse a radius or a lag that no needle of this design has."""
    largest_deg = math.degrees(_LARGEST_LAG_RAD)
    if (
        1.0 / _RADIUS_FACTOR < radius_mm / expected_mm < _RADIUS_FACTOR
        and max(abs(lag_rad), abs(deepest_rad)) <= _LARGEST_LAG_RAD
    ):
        return
    raise MeasurementRefusedError(
        f"the bends for the torsion fit a radius of {radius_mm:.1f} mm and a lag of {math.degrees(deepest_rad):.0f} "
        f"degrees at the deepest turn; {expected_mm:g} mm within a factor of {_RADIUS_FACTOR:g} and {largest_deg:.0f} "
        "degrees at most are expected",
        "look at the pictures, at needle and gel",
    )


def _find_residuals(
    unknown: FloatArray, bends: Sequence[TorsionBend], depths_mm: Sequence[float], lengths: BendLengths
) -> FloatArray:
    """Return modelled less seen deflections, two of each bend; unknown: lag, lag per mm, radius, means by depth."""
    lag_rad, per_mm, radius_mm = unknown[:3]
    bent_mm = radius_mm * (1.0 - math.cos(lengths.bent_mm / radius_mm))
    turned_mm = radius_mm * (1.0 - math.cos((lengths.turned_mm - lengths.backlash_mm / 2) / radius_mm))
    residuals = []
    for bend in bends:
        mean_mm = unknown[3 + depths_mm.index(bend.depth_mm)]
        residuals += [
            -bent_mm * math.cos(lag_rad + per_mm * bend.bent_from_mm) - bend.bent_mm,
            mean_mm
            - bend.direction * turned_mm * math.sin(lag_rad + per_mm * bend.depth_mm)
            - bend.turned_mm,
        ]
    return np.array(residuals)
