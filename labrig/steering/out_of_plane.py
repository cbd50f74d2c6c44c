"""How far the tip may be out of the steering plane, which one camera does not see.

To first order the needle leans out of the plane by lean' = sin(bevel) / r + noise along its length s, and is displaced
by x' = lean, so that a bend made at s displaces the tip at L by (L - s) times as much. Four sources are known:

- The roll zero is off by a constant e. A bend at the roll d then leads out of the plane by cos(d) e / r, as if the
  whole path were turned about the axis of its start.
- Torsion: friction on the shaft keeps the bevel behind its drive by a lag h, whichever way it was turned last. Half
  turns back and forth alternate both the side of the bend and the sign of the lag, so that their parts add up.
- The heading wanders out of the plane with q per root of the length: x has the standard deviation q sqrt(L^3 / 3).
- The start is displaced, and leans.

The sources are independent; none is seen, so all are taken as normal about 0. In space a path that is turned about its
start by e has x = e y. The first order puts the integral of the heading in place of y, the integral of its sine: 3 %
more at a heading of 25 degrees, 8 % at 40.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from labrig.needle.kinematics import FloatArray
from labrig.steering.torsion import RolledStretch, TorsionalLag, displace_by_bends
from labrig.vision.out_of_plane import covary_walk


@dataclass(frozen=True)
class OutOfPlaneSettings:
    """Standard deviations of what leads the needle out of the plane.

    Parameters
    ----------
    heading_sd_rad_per_root_mm : float
        Of the lean after a millimetre; it grows with the square root of the length.
    start_sd_mm, start_sd_rad : float
        Of the place and the lean of the needle where it leaves the sheath.
    roll_zero_sd_rad : float
        Of the roll zero.
    lag : TorsionalLag
        Its errors are those of the bevel's lag behind its drive that is left after compensation.
    """

    heading_sd_rad_per_root_mm: float
    start_sd_mm: float
    start_sd_rad: float
    roll_zero_sd_rad: float
    lag: TorsionalLag


@dataclass(frozen=True)
class OutOfPlaneBudget:
    """Standard deviation of the tip's place out of the plane by source [mm]."""

    roll_zero: float
    torsion: float
    heading_noise: float
    start: float

    @property
    def total_mm(self) -> float:
        """Standard deviation of the tip's place out of the plane by all sources."""
        return math.hypot(*vars(self).values())


def budget_out_of_plane(
    stretches: Sequence[RolledStretch], radius_mm: float, settings: OutOfPlaneSettings
) -> OutOfPlaneBudget:
    """Return how far the tip may be out of the plane at the end of these stretches.

    Parameters
    ----------
    stretches : sequence of RolledStretch
        From the start of the path on.
    radius_mm : float
        Of the needle's arcs.
    settings : OutOfPlaneSettings
    """
    length_mm = sum(stretch.length_mm for stretch in stretches)
    roll_mm, lags_mm = _displace(stretches, radius_mm, settings, np.array([length_mm]))
    return OutOfPlaneBudget(
        roll_zero=settings.roll_zero_sd_rad * abs(float(roll_mm[0])),
        torsion=math.hypot(*lags_mm[:, 0]),
        heading_noise=settings.heading_sd_rad_per_root_mm * math.sqrt(length_mm**3 / 3.0),
        start=math.hypot(settings.start_sd_mm, settings.start_sd_rad * length_mm),
    )


def covary_out_of_plane(
    stretches: Sequence[RolledStretch], radius_mm: float, settings: OutOfPlaneSettings, at_mm: FloatArray
) -> FloatArray:
    """Return how the places out of the plane along a needle vary together, (N, N) [mm^2], at arc lengths (N,).

    Parameters are those of `budget_out_of_plane`, whose total is the root of the last element for the whole
    length.
    """
    roll_mm, lags_mm = _displace(stretches, radius_mm, settings, at_mm)
    return np.asarray(
        settings.roll_zero_sd_rad**2 * np.outer(roll_mm, roll_mm)
        + lags_mm.T @ lags_mm
        + settings.heading_sd_rad_per_root_mm**2 * covary_walk(at_mm)
        + settings.start_sd_mm**2
        + settings.start_sd_rad**2 * np.outer(at_mm, at_mm)
    )


def _displace(
    stretches: Sequence[RolledStretch], radius_mm: float, settings: OutOfPlaneSettings, at_mm: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return by how much a radian of roll displaces points of the needle (N,), and the lag does (4, N) [mm].

    Those are standard deviations: of a lag that is the same at all depths and of its growth, each where the direction
    of the turn is known, and where it is not.
    """
    starts_mm, moves_mm = displace_by_bends(stretches, radius_mm, at_mm)
    turned = np.array([stretch.turned for stretch in stretches], dtype=np.float64)
    growth = settings.lag.per_mm_sd_rad * (starts_mm - settings.lag.best_mm)
    lags = [
        moves_mm @ (signs * sd_rad)
        for signs in (-turned, (turned == 0.0).astype(np.float64))
        for sd_rad in (settings.lag.best_sd_rad, growth)
    ]
    return moves_mm.sum(axis=1), np.array(lags)
