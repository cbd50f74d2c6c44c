"""How to turn a bevel that friction keeps behind its drive.

Friction on the shaft lets the bevel stay behind the base that the axis turns, by a lag of up to h on either side: a
play (hysteresis) operator, which no waiting removes. After a turn in the direction t = 1 or -1 to a base angle d the
bevel is at d - t h, and bends the needle out of the plane by sin(d - t h) / r. Half turns back and forth give this the
same sign in every arc; half turns the same way alternate it.

Two measures work together. The base is driven past its angle by the measured lag and then back: the bevel is where it
should be, and no torque is left that would turn it later. What remains is the error of the measured lag, or all of a
lag that was not measured. Its effect on the end of the path depends on the directions of all turns. The directions are
chosen that make it least within the limits of the axis.

Reed, Okamura and Cowan (Modeling and control of needles with torsional friction, IEEE Trans. Biomed. Eng. 56, 2009)
saw lags of more than 45 degrees in needles 100 mm deep.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from labrig.needle.kinematics import FloatArray
from labrig.steering.parameters import Turning

# Directions of so many turns are chosen together; those behind them act on a short rest of the path.
_FORESEEN_TURNS = 8
# Ways that leave this much less are as good.
_SAME_MM = 0.02
_GROWING_SD_RAD = math.radians(0.1)
_Sd = Annotated[float, Field(ge=0)]


@dataclass(frozen=True)
class TorsionalLag:
    """The lag of the bevel behind the base on either side: h = lag_rad + lag_rad_per_mm * length in the gel.

    Without arguments, a lag that was not measured: friction along the needle makes it grow with the depth, to 10
    degrees at 100 mm.

    Attributes
    ----------
    lag_rad, lag_rad_per_mm : float
    best_mm : float
        Depth at which it is known best.
    best_sd_rad, per_mm_sd_rad : float
        Its standard deviation there, and that of its growth, which are independent.
    """

    lag_rad: float = 0.0
    lag_rad_per_mm: float = 0.0
    best_mm: float = 0.0
    best_sd_rad: _Sd = 0.0
    per_mm_sd_rad: _Sd = _GROWING_SD_RAD

    def at(self, length_mm: float) -> float:
        """Return the lag with this length of needle in the gel [rad]; 0 where the line is below."""
        return max(0.0, self.lag_rad + self.lag_rad_per_mm * length_mm)

    def find_sd_rad(self, length_mm: float) -> float:
        """Return its standard deviation with this length of needle in the gel."""
        return math.hypot(self.best_sd_rad, self.per_mm_sd_rad * (length_mm - self.best_mm))


@dataclass(frozen=True)
class RolledStretch:
    """A length of path inserted without a turn of the bevel.

    Attributes
    ----------
    length_mm : float
    roll_rad : float
        Of the bevel as commanded, from the roll zero: 0 bends towards -y.
    turned : int
        The direction in which the bevel was turned last: 1, -1, or 0 if that is not known.
    """

    length_mm: float
    roll_rad: float
    turned: int


@dataclass(frozen=True)
class BaseLimits:
    """Between which angles the base may turn, from the roll zero [rad]."""

    low_rad: float
    high_rad: float

    @classmethod
    def of_axis(cls, limits_rad: tuple[float, float], zero_rad: float) -> "BaseLimits":
        """Return the limits of a rotation axis from the roll zero."""
        low_rad, high_rad = limits_rad
        return cls(low_rad - zero_rad, high_rad - zero_rad)

    def hold(self, angles_rad: FloatArray) -> NDArray[np.bool_]:
        """Return which angles are within the limits."""
        return np.asarray((self.low_rad <= angles_rad) & (angles_rad <= self.high_rad))

    def clip(self, angle_rad: float) -> float:
        """Return the nearest angle within the limits."""
        return min(max(angle_rad, self.low_rad), self.high_rad)


@dataclass(frozen=True)
class TurnAhead:
    """A turn of the bevel by an angle, modulo a full turn, and the length inserted until the next."""

    roll_rad: float
    length_mm: float


@dataclass(frozen=True)
class BaseTurn:
    """How to drive the base: in a direction, first by overshoot_rad past to_rad, then to to_rad.

    Attributes
    ----------
    direction : int
        1 or -1.
    to_rad : float
        From the roll zero; also where the bevel ends, as far as the lag is known.
    overshoot_rad : float
        With the sign of the direction; 0: drive to to_rad at once.
    """

    direction: int
    to_rad: float
    overshoot_rad: float

    @property
    def farthest_rad(self) -> float:
        """Where the base turns back."""
        return self.to_rad + self.overshoot_rad


def displace_by_bends(
    stretches: Sequence[RolledStretch], radius_mm: float, at_mm: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return how bends of stretches, each turned by a radian out of the plane, lead the needle out of it.

    To first order, a bend at the arc length s moves the point at L by L - s times its angle.

    Returns
    -------
    starts_mm : (N,) array
        Where the stretches begin.
    moves_mm : (A, N) array
        How far each stretch moves the points at the arc lengths `at_mm` (A,).
    """
    lengths_mm = np.array([stretch.length_mm for stretch in stretches])
    starts_mm = np.cumsum(lengths_mm) - lengths_mm
    within_mm = np.clip(at_mm[:, None] - starts_mm, 0.0, lengths_mm)
    leans = np.cos([stretch.roll_rad for stretch in stretches]) * within_mm / radius_mm
    return starts_mm, leans * (at_mm[:, None] - starts_mm - 0.5 * within_mm)


def _displace_end(stretches: Sequence[RolledStretch], lag: TorsionalLag, radius_mm: float) -> FloatArray:
    """Return by how much a lag at each stretch displaces the end of the path, (N, 2) [mm].

    The two are standard deviations: of a lag that is the same at all depths, and of its growth.
    """
    end_mm = np.array([sum(stretch.length_mm for stretch in stretches)])
    starts_mm, moves_mm = displace_by_bends(stretches, radius_mm, end_mm)
    growth_rad = lag.per_mm_sd_rad * (starts_mm - lag.best_mm)
    return -np.column_stack((moves_mm[0] * lag.best_sd_rad, moves_mm[0] * growth_rad))


def choose_turn(
    path: Sequence[RolledStretch],
    base_rad: float,
    turns: Sequence[TurnAhead],
    lag: TorsionalLag,
    limits: BaseLimits,
    *,
    radius_mm: float,
    turning: Turning = "compensated",
) -> BaseTurn:
    """Return how to make the first of these turns, so that errors of the lag displace the end of the path least.

    Of ways that are as good, the least wound up is taken. If the limits of the axis leave no way for all turns, as many
    of them as possible are looked at; an overshoot beyond a limit ends there.

    Parameters
    ----------
    path : sequence of RolledStretch
        Inserted so far.
    base_rad : float
        Where the base stands, from the roll zero.
    turns : sequence of TurnAhead
        The turn to make now, and those that are planned.
    lag : TorsionalLag
        As measured; zero if it is not known.
    limits : BaseLimits
    radius_mm : float
    turning : {"compensated", "back_and_forth"}
        Back and forth, the turn leads back towards the roll zero or away from it, and nothing is done about a lag.
    """
    if turning == "back_and_forth":
        direction = -1 if base_rad > 0.0 else 1
        return BaseTurn(direction, base_rad + direction * abs(turns[0].roll_rad), 0.0)
    depth_mm, foreseen = sum(stretch.length_mm for stretch in path), turns[:_FORESEEN_TURNS]
    # A turn either way leaves the bevel at the same roll: its lag displaces the end by as much, to either side.
    rolls_rad = base_rad + np.cumsum([turn.roll_rad for turn in foreseen])
    ahead = [
        RolledStretch(turn.length_mm, roll, 1)
        for turn, roll in zip(foreseen, rolls_rad.tolist(), strict=True)
    ]
    by_turn = _displace_end((*path, *ahead), lag, radius_mm)
    so_far = np.array([stretch.turned for stretch in path]) @ by_turn[: len(path)]
    forth = np.array([turn.roll_rad % (2.0 * math.pi) for turn in foreseen])
    back = np.array([-(-turn.roll_rad % (2.0 * math.pi)) for turn in foreseen])
    lags_rad = [
        lag.at(depth_mm + sum(turn.length_mm for turn in foreseen[:number]))
        for number in range(len(foreseen))
    ]
    for count in range(len(foreseen), 0, -1):
        ways = np.array(list(product((1, -1), repeat=count)))
        to_rad = base_rad + np.cumsum(np.where(ways > 0, forth[:count], back[:count]), axis=1)
        farthest_rad = to_rad + ways * lags_rad[:count]
        held = limits.hold(to_rad).all(axis=1) & limits.hold(farthest_rad).all(axis=1)
        if held.any():
            sd_mm = np.hypot(*(so_far + ways @ by_turn[len(path) : len(path) + count]).T)
            best = np.lexsort((np.abs(farthest_rad).max(axis=1), np.round(sd_mm / _SAME_MM), ~held))[0]
            direction = int(ways[best, 0])
            return BaseTurn(direction, float(to_rad[best, 0]), direction * lags_rad[0])
    return _turn_where_room_is(base_rad, (float(forth[0]), float(back[0])), lags_rad[0], limits)


def centre_bevel(from_rad: float, lag: TorsionalLag, limits: BaseLimits) -> BaseTurn:
    """Return how to bring the bevel from a base angle to the roll zero while the needle is in the sheath."""
    direction = 1 if from_rad <= 0.0 else -1
    return BaseTurn(direction, 0.0, limits.clip(direction * lag.at(0.0)))


def _turn_where_room_is(
    base_rad: float, either_way_rad: tuple[float, float], lag_rad: float, limits: BaseLimits
) -> BaseTurn:
    """Return the turn that comes least close to a limit; its overshoot ends at the limit."""
    middle_rad = 0.5 * (limits.low_rad + limits.high_rad)
    to_rad, direction = min(
        ((base_rad + turn, way) for turn, way in zip(either_way_rad, (1, -1), strict=True)),
        key=lambda end: abs(end[0] - middle_rad),
    )
    farthest_rad = limits.clip(to_rad + direction * lag_rad)
    return BaseTurn(direction, to_rad, max(0.0, direction * (farthest_rad - to_rad)) * direction)
