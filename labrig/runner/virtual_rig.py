"""A rig without devices, bus or pictures: axes in closed form, and the simulated world.

It implements `RigCalls` under the real `Session`, so that a procedure runs on it as it is: for `labrig check`, and for
campaigns. Axes follow the trapezoid of their drives and read in whole counts. A reading that nobody waits for is
skipped. What pictures show is asked of the world (`virtual_sight`); a picture is drawn only if its pixels are read.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from labrig.devices.axis_description import AXES, AxisDescription, refuse_unreferenced
from labrig.devices.axis_positions import AxisPositions
from labrig.devices.clocks import SimulatedClock
from labrig.devices.drives.drive import DriveReading, Setpoint
from labrig.devices.needle_state import NeedleState, RigState
from labrig.devices.operator import NO_OFFER, Answer, Offer, OperatorRequest
from labrig.devices.rig_calls import Photograph, RigCalls
from labrig.devices.rig_file import RigDescription
from labrig.devices.simulated.operator import SimulatedOperator
from labrig.devices.trapezoid import Limits, Profile, make_brake_profile, make_move_profile, make_rest_profile
from labrig.errors import LimitError, Problem
from labrig.record.events import Event
from labrig.simulation.world import Glance, World
from labrig.vision.picture import Picture

_T = TypeVar("_T")

_UNDRAWN: NDArray[np.uint8] = np.zeros((1, 1), np.uint8)
_INSTANT_S = 1e-6
_REFERENCING_S = 0.5
"""How long the simulated drives take to reference all axes where they stand."""

_ENABLED = 0x0637
"""Statusword of a drive whose operation is enabled (CiA 402)."""


class _Axis:
    """An axis that follows the trapezoid of its moves."""

    def __init__(self, description: AxisDescription) -> None:
        self.description = description
        self.motion: Profile = make_rest_profile(0.0, 0.0)
        self._scale = description.scale()
        self._zero = 0.0

    def at(self, now_s: float) -> float:
        """Return where it stands, in whole counts."""
        return self._round(self.motion.at(now_s)[0]) - self._zero

    def start(self, now_s: float, position: float, speed: float) -> Setpoint:
        """Start a move, which ends at the limits; an axis in motion goes on to the new position."""
        position = min(max(position, self.description.limits[0]), self.description.limits[1])
        sent_speed = self._scale.to_speed(self._scale.to_speed_units(speed))
        target = self._round(position)
        here, velocity = self.motion.at(now_s)
        rate = self.description.acceleration
        limits = Limits(sent_speed, rate, rate)
        self.motion = make_move_profile(now_s, here, velocity, target + self._zero, limits)
        return Setpoint(position, speed, target, sent_speed)

    def stop(self, now_s: float) -> float:
        """Brake, and return when it stands still [s]."""
        here, velocity = self.motion.at(now_s)
        self.motion = make_brake_profile(now_s, here, velocity, self.description.acceleration)
        return self.motion.end_s

    def set_zero(self, now_s: float) -> None:
        """Take the present position as zero."""
        self._zero = self._round(self.motion.at(now_s)[0])

    def find_passing_s(self, now_s: float, passing: float) -> float:
        """Return when it is at a position on its way up; its arrival if it never gets there."""
        end_s, target = self.motion.end_s, passing + self._zero
        if self.motion.end_position < target or self.motion.at(now_s)[0] >= target:
            return end_s if self.motion.end_position < target else now_s
        return float(brentq(lambda t_s: self.motion.at(t_s)[0] - target, now_s, end_s))

    def _round(self, position: float) -> float:
        return self._scale.to_position(self._scale.to_counts(position))


@dataclass(frozen=True, eq=False)
class VirtualPhotograph(Photograph):
    """What a picture would show; its pixels are drawn when they are read, of the world as it is then."""

    glance: Glance | None = None
    world: World | None = None
    since_turn_mm: float = 0.0

    def read(self) -> Picture:
        """Draw the picture."""
        assert self.world is not None
        return self.world.picture()

    def paint(self, paint: Callable[[Picture], Picture]) -> Picture:  # noqa: ARG002 - nobody looks at it
        """Draw nothing."""
        return self.image


class VirtualRig(RigCalls):
    """See the module; each call is that of `RigCalls`.

    Parameters
    ----------
    description : RigDescription
        Its rig file.
    world : World
        What axes and operator act on.
    state : RigState
        What is known of the needle; changes of it are kept in memory alone.
    picture_s : float
        How long a picture takes [s].
    """

    def __init__(self, description: RigDescription, world: World, state: RigState, picture_s: float) -> None:
        self.description = description
        self.clock = SimulatedClock()
        self.needle = NeedleState(None, state)
        self.world = world
        self.refused: dict[str, Problem] = {}
        self._axes = {name: _Axis(axis) for name, axis in description.axes.items()}
        self._operator = SimulatedOperator(world)
        self._picture_s = picture_s
        self._period_s = 1.0 / description.recording.state_rate_hz
        self._turned_at_mm = self._rotation_rad = 0.0

    def _move_world(self) -> dict[str, float]:
        now_s = self.clock.now_s()
        here = {name: axis.at(now_s) for name, axis in self._axes.items()}
        self.world.advance(here["insertion"], here["rotation"], here["linear"])
        if here["rotation"] != self._rotation_rad:
            self._rotation_rad, self._turned_at_mm = here["rotation"], here["insertion"]
        return here

    def read_states(self) -> Mapping[str, DriveReading]:
        """Return where the axes are now."""
        here, now_s = self._move_world(), self.clock.now_s()
        return {
            name: DriveReading(here[name], _ENABLED, now_s >= self._find_arrival_s(axis))
            for name, axis in self._axes.items()
        }

    def _find_arrival_s(self, axis: _Axis) -> float:
        """Return from when a reading says that an axis has arrived: one before has to have said so."""
        return axis.motion.end_s + self._period_s - _INSTANT_S

    def take_picture(self) -> VirtualPhotograph:
        """Look at the world."""
        here = self._move_world()
        self.clock.sleep(self._picture_s)
        return VirtualPhotograph(
            _UNDRAWN,
            self.clock.now_s(),
            AxisPositions(here["insertion"], here["rotation"], here["linear"]),
            glance=self.world.glance(),
            world=self.world,
            since_turn_mm=here["insertion"] - self._turned_at_mm,
        )

    def check_move(self, axis_name: str, position: float, speed: float) -> None:
        """Note a move that an axis may not make, and let it be made, so that all of them are told."""
        try:
            super().check_move(axis_name, position, speed)
        except LimitError as error:
            self.refused[error.message] = Problem(f"rig axes.{axis_name}", error.message, error.hint)
        if axis_name not in self.needle.state.referenced:
            raise refuse_unreferenced(axis_name)

    def start_move(self, axis_name: str, position: float, speed: float) -> Setpoint:
        """Start a move."""
        return self._axes[axis_name].start(self.clock.now_s(), position, speed)

    def wait(self, duration_s: float) -> None:
        """Let rig time pass."""
        self.clock.sleep(duration_s)

    def await_reading(self, axis_name: str | None = None, passing: float | None = None) -> None:
        """Pass on to the first reading at which an axis has arrived, or is beyond a position."""
        now_s, readings = self.clock.now_s(), 1
        if axis_name is not None:
            axis = self._axes[axis_name]
            due_s = self._find_arrival_s(axis)
            if passing is not None:
                due_s = min(due_s, axis.find_passing_s(now_s, passing))
            readings = max(1, int(np.ceil((due_s - now_s) / self._period_s - 1e-9)))
        self.clock.sleep(readings * self._period_s)

    def ask(
        self,
        request: OperatorRequest,
        offer: Offer = NO_OFFER,
        also: Callable[[], None] = lambda: None,  # noqa: ARG002 - never waits
    ) -> Answer:
        """Let the simulated operator do it."""
        return self._operator.ask(request, lambda: None, offer)

    def reference_axes(self) -> None:
        """Take the present positions as zero."""
        self.needle.refuse_in_tissue("no axis is homed", self.description.option)
        for axis in self._axes.values():
            axis.set_zero(self.clock.now_s())
        self.clock.sleep(_REFERENCING_S)
        self.needle.update(referenced=AXES, roll_zero=None)

    def stop(self) -> None:
        """Stop every axis."""
        now_s = self.clock.now_s()
        self.clock.sleep(max([0.0, *(axis.stop(now_s) - now_s for axis in self._axes.values())]))

    def truth(self) -> tuple[dict[str, object], ...]:
        """Return what is true of the present insertion."""
        return (self.world.truth(),)


@dataclass
class EventList:
    """A record in memory: the events, the truth lines, and how many pictures were taken.

    `drawn` are those of the pictures that have a drawing on them.
    """

    events: list[Event] = field(default_factory=list)
    truths: list[Mapping[str, object]] = field(default_factory=list)
    frames: int = 0
    drawn: int = 0
    sights: int = 0
    path: Path = Path("not kept")
    run_name: str = "virtual"

    def frame(self, image: NDArray[np.uint8], t_s: float, **fields: object) -> int:  # noqa: ARG002
        """Count a picture, and return its number."""
        self.frames += 1
        self.drawn += bool(fields.get("drawn"))
        return self.frames - 1

    def state(self, t_s: float, **fields: object) -> None:
        """Leave out a reading."""

    def event(self, kind: str, t_s: float, **fields: object) -> None:
        """Leave out an event without a model."""

    def record_event(self, event: Event, t_s: float) -> None:  # noqa: ARG002
        """Keep an event."""
        self.events.append(event)

    def truth(self, **fields: object) -> None:
        """Keep a truth."""
        self.truths.append(fields)

    def can_frames(self, frames: Iterable[tuple[float, int, bytes, str]]) -> None:
        """Leave out the bus."""

    def close(self, exit_status: str, reason: str, ended: datetime, **manifest_updates: object) -> None:
        """Do nothing."""
