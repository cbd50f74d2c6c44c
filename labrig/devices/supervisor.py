"""What is watched while a rig is open, how often, and what each finding does: all of it stands in this file.

`Supervisor.step` goes through the checks below from top to bottom. Whoever lets rig time pass calls it again and again,
at least once in a period of the heartbeat: `Rig.wait`, a question, and everything that is done aside. One thread does
so, and it alone sends the heartbeat: a labrig that hangs, is stopped or is killed sends none, and the drives stop by
themselves.

===============  ====================================  ============================  ===================================
check            watches                               looks                         raises
===============  ====================================  ============================  ===================================
`Awake`          suspension of the computer            at each step                  `SafetyStopError`
`BusTrouble`     errors of the CAN adapter             at each step                  `BusError`
`Requests`       signals; `devices stop` is SIGTERM    at each step, unless told     `InterruptedRunError`
`OtherMaster`    commands of another program           at each step with power       `SecondMasterError`
`Drives`         emergencies, boot-ups, heartbeats     at each step                  `DriveError`
`NmtStates`      the NMT state of each drive           at each step with power       `DriveStrayedError`
`Beat`           nothing: it sends the heartbeat       at each step, when due        `BusError`
`Readings`       nothing: it reads the axes            after `LOOK_S` unread         `DriveError`, `BusError`
`Positions`      where each axis is                    at each reading               `DriveStrayedError`
`Targets`        which target each drive has           at a reading, each `LOOK_S`   `DriveStrayedError`
`Inputs`         inputs with limits                    at each reading               `ForceGuardError`
`Stalls`         current and following error           the faster the axis, the      `ForceGuardError`
                                                       more often
===============  ====================================  ============================  ===================================

Whatever is found, `Rig` does the same: it posts a halt to every axis before it awaits any answer, reads back that each
stands still, and ends what it was doing. If one may still move, or a drive is lost, nothing beats any more.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import ClassVar, TypeVar

from labrig.clock import Clock
from labrig.devices.axis import Axis, AxisReadback
from labrig.devices.bus import CanLink
from labrig.devices.bus_watch import BusWatch
from labrig.devices.drives.drive import DriveReading, raise_together
from labrig.devices.heartbeat import HeartbeatClock
from labrig.devices.opening import Opening
from labrig.devices.position_supervision import (
    TIME_MARGIN_S,
    AxisBounds,
    InMotion,
    PositionReading,
    SupervisionState,
    bound_lag,
    supervise_position,
)
from labrig.devices.stall import LoadReading, StallBounds, supervise_stall
from labrig.errors import POSITION_JUMPED, InterruptedRunError, MachineError

LOOK_S = 0.15
"""Axes that nobody has read for so long are read; targets are read back so often [s]."""

_EARLY_S = 1e-6

Interrupted = Callable[[], str | None]
"""Returns the name of a signal that has arrived, or None."""

_State = TypeVar("_State", DriveReading, AxisReadback)


@dataclass(frozen=True)
class Reading:
    """A reading of every axis: the instants of rig time between which it was measured [s], and the answers."""

    from_s: float
    until_s: float
    axes: Mapping[str, DriveReading | AxisReadback]

    def place_of(self, axis: str) -> PositionReading:
        """Return where an axis was."""
        return PositionReading(self.from_s, self.until_s, self.axes[axis].position)


class Check:
    """One thing that is watched; a check overrides what it needs.

    Attributes
    ----------
    needs_power : bool
        Whether it is left out while no drive has power.
    """

    needs_power: ClassVar[bool] = True

    def look(self) -> None:
        """Look, and raise what is found; called at each step."""

    def on_reading(self, reading: Reading) -> None:
        """Judge a reading of the axes, and raise what is found."""

    def reset(self) -> None:
        """Begin anew, as power is going to be switched on. Raises what must keep it off."""


class Supervisor:
    """Goes through its checks in order.

    Parameters
    ----------
    checks : sequence of Check
        The checks; the order matters, as the heartbeat is one of them and comes after what must keep it from being
        sent.
    """

    def __init__(self, checks: Sequence[Check]) -> None:
        self._checks = checks
        self.has_power = False

    def step(self) -> None:
        """Look at everything once. Raises `InterruptedRunError`, `SafetyStopError`, `BusError`, `DriveError`."""
        for check in self._checks:
            if self.has_power or not check.needs_power:
                check.look()

    def reset(self) -> None:
        """Begin anew before power is switched on. Raises what must keep it off, as `step`."""
        for check in self._checks:
            check.reset()


class Awake(Check):
    """The computer was not suspended for longer than the drives bear."""

    needs_power = False

    def __init__(self, heartbeat: HeartbeatClock) -> None:
        self._heartbeat = heartbeat

    def look(self) -> None:
        """Raise `SafetyStopError` after a suspension."""
        self._heartbeat.require_awake()


class BusTrouble(Check):
    """The CAN adapter works."""

    needs_power = False

    def __init__(self, link: CanLink) -> None:
        self._link = link

    def look(self) -> None:
        """Raise the `BusError` of a bus that has failed."""
        if self._link.trouble is not None:
            raise self._link.trouble


class Requests(Check):
    """Nobody wants the run to end.

    Attributes
    ----------
    heeded : callable or None
        Returns a signal that has arrived; None while none is heeded.
    """

    needs_power = False

    def __init__(self, heeded: Interrupted | None) -> None:
        self.heeded = heeded

    def look(self) -> None:
        """Raise `InterruptedRunError` after a signal."""
        signal = None if self.heeded is None else self.heeded()
        if signal is not None:
            raise InterruptedRunError(f"interrupted by {signal}")


class OtherMaster(Check):
    """No other program commands the drives, or beats as labrig does."""

    def __init__(self, watch: BusWatch) -> None:
        self._watch = watch

    def look(self) -> None:
        """Raise `SecondMasterError`."""
        self._watch.require_no_command()

    def reset(self) -> None:
        """Refuse a program that only asks, too: it is about to command. Raises `SecondMasterError`."""
        self._watch.require_free()


class Drives(Check):
    """No drive has reported a fault, has restarted, or has stopped its heartbeat."""

    needs_power = False

    def __init__(self, axes: Sequence[Axis]) -> None:
        self._drives = [axis.drive for axis in axes]

    def look(self) -> None:
        """Raise the `DriveError` of the first that has; nothing is sent."""
        for drive in self._drives:
            drive.check()


class NmtStates(Check):
    """Every drive says in its heartbeat that it is operational."""

    def __init__(self, watch: BusWatch) -> None:
        self._watch = watch

    def look(self) -> None:
        """Raise `DriveStrayedError`."""
        self._watch.require_operational()

    def reset(self) -> None:
        """Forget the states that drives had before they were started."""
        self._watch.forget_states()


class Beat(Check):
    """All that stands before it has passed: the heartbeat may be sent."""

    needs_power = False

    def __init__(self, heartbeat: HeartbeatClock) -> None:
        self._heartbeat = heartbeat

    def look(self) -> None:
        """Send it if it is due. Raises `BusError`."""
        self._heartbeat.beat()


class Readings(Check):
    """Reads the axes while nobody else does, and remembers where each was last.

    Parameters
    ----------
    axes : mapping of str to Axis
        The open axes.
    clock : Clock
        Rig time.
    judges : sequence of Check
        Judge each reading.

    Attributes
    ----------
    last_s : float
        When the axes were read last [s].
    positions : mapping of str to tuple of float
        Axis -> when it was read last [s], and where it was [mm or rad].
    """

    def __init__(self, axes: Mapping[str, Axis], clock: Clock, judges: Sequence[Check]) -> None:
        self._axes = axes
        self._clock = clock
        self._judges = judges
        self.last_s = 0.0
        self.positions: dict[str, tuple[float, float]] = {}

    def look(self) -> None:
        """Read the axes that nobody has read of late. Raises `DriveError`, `BusError`, and as the judges."""
        if self._clock.now_s() - self.last_s >= LOOK_S:
            self.take(_read_drive)

    def take(
        self, read: Callable[[Axis], _State], announce: Callable[[], None] = lambda: None
    ) -> dict[str, _State]:
        """Read every axis and have it judged.

        Parameters
        ----------
        read : callable
            Reads an axis.
        announce : callable
            Called before, and after the time was taken: a busy computer may be held up once the drives have measured.
        """
        self.last_s = self._clock.now_s()
        announce()
        states = {name: read(axis) for name, axis in self._axes.items()}
        for name, state in states.items():
            self.positions[name] = (self.last_s, state.position)
        reading = Reading(self.last_s, self._clock.now_s(), states)
        for judge in self._judges:
            judge.on_reading(reading)
        return states


def _read_drive(axis: Axis) -> DriveReading:
    return axis.drive.read()


class Positions(Check):
    """Every axis is where it should be (`position_supervision`).

    Attributes
    ----------
    jumped : set of str
        Axes whose position has jumped: nobody knows their zero.
    """

    def __init__(self, axes: Mapping[str, Axis]) -> None:
        self._axes = axes
        self._bounds = {name: AxisBounds.of(name, axis.description) for name, axis in axes.items()}
        self._seen = dict.fromkeys(axes, SupervisionState())
        self.jumped: set[str] = set()

    def on_reading(self, reading: Reading) -> None:
        """Raise the `DriveStrayedError`s of all that are not."""
        errors = []
        for name, axis in self._axes.items():
            self._seen[name], error = supervise_position(
                self._bounds[name], self._seen[name], axis.expected, reading.place_of(name)
            )
            if error is not None:
                errors.append(error)
                if error.fault is POSITION_JUMPED:
                    self.jumped.add(name)
        raise_together(errors)


class Targets(Check):
    """Every drive has the target that was sent: those in motion; where none moves, one drive after another."""

    def __init__(self, axes: Mapping[str, Axis]) -> None:
        self._axes = axes
        self._due = list(axes.values())
        self._looked_s = 0.0

    def on_reading(self, reading: Reading) -> None:
        """Read targets back if it is time to. Raises `DriveStrayedError`, `DriveError`, `BusError`."""
        if reading.from_s - self._looked_s < LOOK_S:
            return
        self._looked_s = reading.from_s
        self._due.append(self._due.pop(0))
        moving = [axis for axis in self._axes.values() if isinstance(axis.expected, InMotion)]
        for axis in moving or self._due[:1]:
            axis.require_target()


class Inputs(Check):
    """Every input is within its limits."""

    def __init__(self, axes: Mapping[str, Axis]) -> None:
        self._axes = axes

    def on_reading(self, reading: Reading) -> None:
        """Raise the `ForceGuardError`s of all that are not."""
        self._require({name: state.inputs for name, state in reading.axes.items() if state.inputs})

    def reset(self) -> None:
        """Read them before power is switched on. Raises `ForceGuardError`, `DriveError`, `BusError`."""
        self._require({name: axis.drive.read_inputs() for name, axis in self._axes.items()})

    def _require(self, inputs: Mapping[str, Mapping[str, float | bool]]) -> None:
        excesses = [
            self._axes[name].description.inputs[channel].find_excess(channel, name, value)
            for name, values in inputs.items()
            for channel, value in values.items()
        ]
        raise_together([excess for excess in excesses if excess is not None])


class Stalls(Check):
    """No axis in motion is held up by something (`stall`); one that is is stopped quickly.

    The following error is asked for first, and the current only of an axis that lags. A position that was read anyway
    and shows no lag spares a look.

    Parameters
    ----------
    axes : mapping of str to Axis
        The axes for which rig file, protocol or command name a current limit; another one has no stall.
    clock : Clock
        Rig time.
    """

    def __init__(self, axes: Mapping[str, Axis], clock: Clock) -> None:
        self._axes = axes
        self._clock = clock
        self._bounds: dict[str, StallBounds] = {}
        self._looked_s: dict[str, float] = {}
        self._since_s: dict[str, float | None] = {}

    def reset(self) -> None:
        """Read which current limits are in force. Raises `DriveError`, `BusError`."""
        for name, axis in self._axes.items():
            drive, limit_ma = axis.drive, axis.drive.current_limit_ma()
            if limit_ma is not None and drive.lag() is not None and drive.current_ma() is not None:
                self._bounds[name] = StallBounds(
                    name, axis.unit, axis.description.max_following_error, limit_ma
                )

    @property
    def period_s(self) -> float:
        """How often the axes in motion have to be looked at [s]."""
        return min((self._period_s(name) for name in self._bounds), default=math.inf)

    def _period_s(self, name: str) -> float:
        expected = self._axes[name].expected
        return self._bounds[name].period_s(expected.speed) if isinstance(expected, InMotion) else math.inf

    def on_reading(self, reading: Reading) -> None:
        """Spare an axis a look that cannot lag by its position."""
        for name, bounds in self._bounds.items():
            expected = self._axes[name].expected
            # A fast axis has gone too far while its position was read.
            if not isinstance(expected, InMotion) or bounds.is_suspect(2 * TIME_MARGIN_S * expected.speed):
                continue
            if not bounds.is_suspect(bound_lag(expected, reading.place_of(name))):
                self._looked_s[name], self._since_s[name] = reading.until_s, None

    def look(self) -> None:
        """Look at each axis in motion that is due. Raises `ForceGuardError`, `DriveError`, `BusError`."""
        for name in self._bounds:
            now_s, period_s = self._clock.now_s(), self._period_s(name)
            if math.isinf(period_s):
                self._since_s.pop(name, None)
            elif now_s - self._looked_s.get(name, -math.inf) >= period_s - _EARLY_S:
                self._looked_s[name] = now_s
                self._look_at(name, now_s)

    def _look_at(self, name: str, now_s: float) -> None:
        bounds, drive = self._bounds[name], self._axes[name].drive
        lag = drive.lag()
        if lag is None or not bounds.is_suspect(lag):
            self._since_s[name] = None
            return
        load = LoadReading(now_s, lag, drive.current_ma() or 0.0)
        self._since_s[name], error = supervise_stall(bounds, self._since_s.get(name), load)
        if error is not None:
            # A halt brakes as slowly as a move does: it would push on, and let the drive fail by its following error.
            with suppress(MachineError):
                drive.stop(quick=True)
            raise error


class RigChecks:
    """The checks of an opened rig.

    Parameters
    ----------
    axes : mapping of str to Axis
        The open axes.
    watch : BusWatch
        Listens on their bus.
    heartbeat : HeartbeatClock
        Rig time, and the heartbeat.
    interrupted : callable
        Returns a signal that has arrived.
    opening : Opening
        Whether limits of inputs hold, and which axes have a limit of their current.

    Attributes
    ----------
    ordered : tuple of Check
        All of them, in the order in which a `Supervisor` goes through them.
    """

    def __init__(
        self,
        axes: Mapping[str, Axis],
        watch: BusWatch,
        heartbeat: HeartbeatClock,
        interrupted: Interrupted,
        opening: Opening,
    ) -> None:
        limited = {name: axis for name, axis in axes.items() if opening.limit_ma(axis) is not None}
        self.requests = Requests(interrupted)
        self.positions = Positions(axes)
        self.stalls = Stalls(limited, heartbeat)
        inputs = [Inputs(axes)] if opening.hold_inputs else []
        judges = (self.positions, Targets(axes), *inputs, self.stalls)
        self.readings = Readings(axes, heartbeat, judges)
        self.ordered: tuple[Check, ...] = (
            Awake(heartbeat),
            BusTrouble(watch.link),
            self.requests,
            OtherMaster(watch),
            Drives(tuple(axes.values())),
            NmtStates(watch),
            Beat(heartbeat),
            self.readings,
            *judges,
        )
