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
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product

from labrig.errors import InputError
from labrig.steering.out_of_plane import RolledStretch
from labrig.steering.parameters import Turning

# Directions of so many turns are chosen together; those behind them act on a short rest of the path.
_FORESEEN_TURNS = 8
# Ways that leave this much less are as good.
_SAME_MM = 0.02


@dataclass(frozen=True)
class LagError:
    """What is uncertain of a lag that is a line over the depth.

    Parameters
    ----------
    best_mm : float
        Depth at which the lag is known best.
    best_sd_rad, per_mm_sd_rad : float
        Its standard deviation there, and that of its growth, which are independent.
    """

    best_mm: float
    best_sd_rad: float
    per_mm_sd_rad: float


_GROWING = LagError(0.0, 0.0, math.radians(0.1))
"""Of a lag that was not measured: friction along the needle makes it grow with the depth. 10 degrees at 100 mm."""


@dataclass(frozen=True)
class TorsionalLag:
    """The lag of the bevel behind the base on either side: h = lag_rad + lag_rad_per_mm * length in the gel.

    Without arguments, a lag that was not measured.
    """

    lag_rad: float = 0.0
    lag_rad_per_mm: float = 0.0
    error: LagError = _GROWING

    def at(self, length_mm: float) -> float:
        """Return the lag with this length of needle in the gel [rad]; 0 where the line is below."""
        return max(0.0, self.lag_rad + self.lag_rad_per_mm * length_mm)


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

    def hold(self, angle_rad: float) -> bool:
        """Return whether an angle is within the limits."""
        return self.low_rad <= angle_rad <= self.high_rad

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


@dataclass(frozen=True)
class LagSensitivity:
    """By how much a lag displaces the end of a path out of the plane, to first order.

    Attributes
    ----------
    constant_mm : float
        dx/dh, for a lag h that is the same at every turn [mm/rad].
    growing_mm2 : float
        For a lag that grows with the depth [mm for each rad/mm].
    """

    constant_mm: float
    growing_mm2: float

    def find_sd_mm(self, error: LagError) -> float:
        """Return the standard deviation of the end's place out of the plane."""
        slope_mm2 = self.growing_mm2 - error.best_mm * self.constant_mm
        return math.hypot(error.best_sd_rad * self.constant_mm, error.per_mm_sd_rad * slope_mm2)


def find_lag_sensitivity(stretches: Sequence[RolledStretch], radius_mm: float) -> LagSensitivity:
    """Return by how much a lag displaces the end of a path.

    A bend at the arc length s displaces the end at L by L - s times its angle. Stretches before which no turn is known
    (`turned` 0) do not count.
    """
    left_mm = sum(stretch.length_mm for stretch in stretches)
    at_mm = constant_mm = growing_mm2 = 0.0
    for stretch in stretches:
        lever_mm = left_mm - 0.5 * stretch.length_mm
        bend = stretch.turned * math.cos(stretch.roll_rad) * stretch.length_mm / radius_mm
        constant_mm -= bend * lever_mm
        growing_mm2 -= bend * lever_mm * at_mm
        left_mm -= stretch.length_mm
        at_mm += stretch.length_mm
    return LagSensitivity(constant_mm, growing_mm2)


def plan_turn(
    path: Sequence[RolledStretch],
    base_rad: float,
    turns: Sequence[TurnAhead],
    lag: TorsionalLag,
    limits: BaseLimits,
    *,
    turning: Turning,
    radius_mm: float,
) -> BaseTurn:
    """Return how the base makes the first of these turns: by `choose_turn`, or back and forth whatever the lag."""
    if turning == "back_and_forth":
        return turn_back_and_forth(base_rad, turns[0].roll_rad)
    return choose_turn(path, base_rad, turns, lag, limits, radius_mm=radius_mm)


def choose_turn(
    path: Sequence[RolledStretch],
    base_rad: float,
    turns: Sequence[TurnAhead],
    lag: TorsionalLag,
    limits: BaseLimits,
    *,
    radius_mm: float,
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

    Raises
    ------
    InputError
        For no turn.
    """
    if not turns:
        raise InputError("there is no turn to make")
    depth_mm = sum(stretch.length_mm for stretch in path)
    foreseen = turns[:_FORESEEN_TURNS]
    for count in range(len(foreseen), 0, -1):
        ways = list(_list_ways(depth_mm, base_rad, foreseen[:count], lag, limits))
        if ways:
            return min(ways, key=lambda way: _rate_way(way, path, foreseen, lag.error, radius_mm))[0]
    return _turn_where_room_is(base_rad, turns[0], lag.at(depth_mm), limits)


def turn_back_and_forth(base_rad: float, roll_rad: float) -> BaseTurn:
    """Return the turn back towards the roll zero, or away from it; nothing is done about a lag."""
    direction = -1 if base_rad > 0.0 else 1
    return BaseTurn(direction, base_rad + direction * abs(roll_rad), 0.0)


def centre_bevel(from_rad: float, lag: TorsionalLag, limits: BaseLimits) -> BaseTurn:
    """Return how to bring the bevel from a base angle to the roll zero while the needle is in the sheath."""
    direction = 1 if from_rad <= 0.0 else -1
    return BaseTurn(direction, 0.0, limits.clip(direction * lag.at(0.0)))


def _list_ways(
    depth_mm: float, base_rad: float, turns: Sequence[TurnAhead], lag: TorsionalLag, limits: BaseLimits
) -> Iterator[tuple[BaseTurn, ...]]:
    """Yield the ways to make these turns within the limits."""
    for directions in product((1, -1), repeat=len(turns)):
        way, to_rad, at_mm = list[BaseTurn](), base_rad, depth_mm
        for direction, turn in zip(directions, turns, strict=True):
            to_rad += _turn_by(turn.roll_rad, direction)
            way.append(BaseTurn(direction, to_rad, direction * lag.at(at_mm)))
            at_mm += turn.length_mm
        if all(limits.hold(made.to_rad) and limits.hold(made.farthest_rad) for made in way):
            yield tuple(way)


def _turn_by(roll_rad: float, direction: int) -> float:
    """Return the turn in a direction that does what a turn by roll_rad does."""
    return direction * ((direction * roll_rad) % (2.0 * math.pi))


def _rate_way(
    way: Sequence[BaseTurn],
    path: Sequence[RolledStretch],
    turns: Sequence[TurnAhead],
    error: LagError,
    radius_mm: float,
) -> tuple[int, float]:
    """Return what the lag leaves at the end of the path, in steps that do not matter, and how far it is wound up."""
    ahead = [
        RolledStretch(turn.length_mm, made.to_rad, made.direction)
        for made, turn in zip(way, turns, strict=False)
    ]
    unforeseen_mm = sum(turn.length_mm for turn in turns[len(way) :])
    rest = [RolledStretch(unforeseen_mm, 0.0, 0)] if unforeseen_mm else []
    sd_mm = find_lag_sensitivity((*path, *ahead, *rest), radius_mm).find_sd_mm(error)
    return round(sd_mm / _SAME_MM), max(abs(made.farthest_rad) for made in way)


def _turn_where_room_is(base_rad: float, turn: TurnAhead, lag_rad: float, limits: BaseLimits) -> BaseTurn:
    """Return the turn that comes least close to a limit; its overshoot ends at the limit."""
    middle_rad = 0.5 * (limits.low_rad + limits.high_rad)
    direction = min((1, -1), key=lambda way: abs(base_rad + _turn_by(turn.roll_rad, way) - middle_rad))
    to_rad = base_rad + _turn_by(turn.roll_rad, direction)
    farthest_rad = limits.clip(to_rad + direction * lag_rad)
    return BaseTurn(direction, to_rad, max(0.0, direction * (farthest_rad - to_rad)) * direction)
