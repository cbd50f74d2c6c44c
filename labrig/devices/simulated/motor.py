"""The motor current of a simulated drive, by a simple model of motor, screw and position controller.

A motor that turns carries its friction and its load: I = (friction + load) / torque constant, in the direction of its
motion. A shaft that something holds makes the position controller push harder the further it lags, by a constant
current for each turn of lag. A motor at rest without lag carries nothing: screw and gear hold themselves. The output
current limit of the drive caps all of it. Inertia is left out. The defaults are those of a small brushed motor with a
gearhead, not of a certain one.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass


def _no_load() -> float:
    return 0.0


@dataclass(frozen=True)
class Motor:
    """A motor and what it drives.

    Parameters
    ----------
    torque_constant_mnm_a : float
        Torque constant [mNm/A].
    friction_mnm : float
        Friction of motor and gearhead, at the motor [mNm].
    stiffness_ma_per_turn : float
        Current with which the position controller answers a lag of one turn of the motor [mA].
    load_mnm : callable
        Returns the torque at the motor that resists its motion now [mNm].
    """

    torque_constant_mnm_a: float = 25.0
    friction_mnm: float = 1.5
    stiffness_ma_per_turn: float = 4000.0
    load_mnm: Callable[[], float] = _no_load

    def current_ma(self, speed: float, lag_turns: float, limit_ma: float) -> float:
        """Return the motor current, with its sign [mA].

        Parameters
        ----------
        speed : float
            Speed of the motor with its sign, in any unit; 0 at rest.
        lag_turns : float
            Position demanded minus position reached [turns of the motor].
        limit_ma : float
            Output current limit of the drive [mA].
        """
        current_ma = self.stiffness_ma_per_turn * lag_turns
        direction = speed or lag_turns
        if direction:
            carried_ma = 1000 * (self.friction_mnm + self.load_mnm()) / self.torque_constant_mnm_a
            current_ma += math.copysign(carried_ma, direction)
        return max(-limit_ma, min(limit_ma, current_ma))


def torque_of_force(force_n: float, travel_per_turn_mm: float, gear_ratio: float) -> float:
    """Return the torque at the motor of a force on a screw without losses, F lead / (2 pi gear) [mNm]."""
    return force_n * travel_per_turn_mm / (2 * math.pi * gear_ratio)
