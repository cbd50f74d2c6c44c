"""A needle for the steering step, driven by its commands; it shares no formula with labrig's bending.

The bend is a vector across the needle's axis. It swings over to where the bevel points at a constant rate, and the
frame of the tip is turned by it in small steps.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from labrig.steering.policy import SteeringCommand, SteeringSettings, TipSighting
from labrig.steering.state import SteeringState
from labrig.steering.step import start_steering, step_steering

Floats = NDArray[np.float64]
STEP_MM = 0.05


@dataclass
class DrivenNeedle:
    """Where the needle is; `closing_mm` and `backlash_mm` of 0: the bend follows the bevel at once.

    `cavity_mm`: between which insertion lengths it goes straight.
    """

    radius_mm: float
    closing_mm: float = 0.0
    backlash_mm: float = 0.0
    cavity_mm: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        self.inserted_mm, self.roll_rad = 0.0, 0.0
        self.place, self.frame = np.zeros(3), Rotation.identity()
        self.bend, self._closed = np.zeros(2), False
        self.path = [self.place]

    def insert(self, to_mm: float) -> None:
        """Cut on to an insertion length."""
        count = max(1, math.ceil((to_mm - self.inserted_mm) / STEP_MM))
        length = (to_mm - self.inserted_mm) / count
        for place in self.inserted_mm + length * np.arange(count):
            bend = self._swung(length) * (not self.cavity_mm[0] <= place < self.cavity_mm[1])
            half = Rotation.from_rotvec((*(bend * length / 2), 0.0))
            self.place = self.place + length * (self.frame * half).apply((0.0, 0.0, 1.0))
            self.frame = self.frame * half * half
            self.path.append(self.place)
        self.inserted_mm = to_mm

    def _swung(self, length: float) -> Floats:
        """Let the bend, as a rotation vector across the axis for a millimetre, go towards the bevel's."""
        goal = np.array((math.cos(self.roll_rad), math.sin(self.roll_rad))) / self.radius_mm
        missing = goal - self.bend
        over_mm = self.backlash_mm / 2 if self._closed else self.closing_mm
        most = length / (self.radius_mm * over_mm) if over_mm else math.inf
        far = float(np.linalg.norm(missing))
        if far <= most:
            self.bend, self._closed = goal, True
        else:
            self.bend = self.bend + missing * most / far
        return self.bend


@dataclass(frozen=True)
class Driven:
    """The states and commands of an insertion, one more than sightings; the last command is a stop."""

    states: list[SteeringState]
    commands: list[SteeringCommand]
    sightings: list[TipSighting]

    @property
    def stop(self) -> str | None:
        """Why it stopped."""
        return self.commands[-1].stop


def drive(
    needle: DrivenNeedle,
    settings: SteeringSettings,
    sigma_mm: float = 0.0,
    seed: int = 0,
    *,
    slip: float = 0.0,
    see: Callable[[DrivenNeedle], Floats | None] = lambda needle: needle.place,
) -> Driven:
    """Carry out the commands of the step until it stops; the tip is observed with independent noise."""
    rng = np.random.default_rng(seed)
    across = np.array((0.0, 1.0, 1.0) if settings.problem.planar else (1.0, 1.0, 1.0))
    state, command = start_steering(settings)
    done = Driven([state], [command], [])
    while command.stop is None and len(done.states) < 1000:
        needle.roll_rad += command.roll_rad
        needle.insert(command.observe_at_mm * (1.0 - slip))
        seen_mm = see(needle)
        noise_mm = sigma_mm * across * rng.normal(size=3)
        place_mm = None if seen_mm is None else seen_mm + noise_mm
        done.sightings.append(TipSighting(command.observe_at_mm, place_mm))
        state, command = step_steering(state, done.sightings[-1], settings)
        done.states.append(state)
        done.commands.append(command)
    return done
