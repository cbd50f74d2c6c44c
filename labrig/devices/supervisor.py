"""What is watched while a rig is open, how often, and what each finding does: all of it stands in this file.

`Supervisor.step` goes through the checks below from top to bottom. Whoever lets rig time pass calls it again and again,
at least once in a period of the heartbeat: `Rig.wait`, a question, and everything that is done aside. One thread does
so, and it alone sends the heartbeat: a labrig that hangs, is stopped or is killed sends none, and the drives stop by
themselves.

===========================  ====================================  =======================  ========================
check                        watches                               looks                    raises
===========================  ====================================  =======================  ========================
`HeartbeatClock`, awake      suspension of the computer            at each step             `SafetyStopError`
`CanLink`, works             errors of the CAN adapter             at each step             `BusError`
`Requests`                   signals; `devices stop` is SIGTERM    at each step, unless     `InterruptedRunError`
                                                                   told not to
`BusWatch`, no command       commands of another program           at each step with power  `SecondMasterError`
drives                       emergencies, boot-ups, heartbeats     at each step             `DriveError`
`BusWatch`, operational      the NMT state of each drive           at each step with power  `DriveStrayedError`
`HeartbeatClock`, beat       nothing: it sends the heartbeat       at each step, when due   `BusError`
`Readings`                   nothing: it reads the axes            after `LOOK_S` unread    `DriveError`, `BusError`
`Positions`                  where each axis is                    at each reading          `DriveStrayedError`
`Targets`                    which target each drive has           at a reading, each       `DriveStrayedError`
                                                                   `LOOK_S`
`Inputs`                     inputs with limits                    at each reading          `ForceGuardError`
`Stalls`                     current and following error           the faster the axis,     `ForceGuardError`
                                                                   the more often
===========================  ====================================  =======================  ========================

Whatever is found, `Rig` does the same: it posts a halt to every axis before it awaits any answer, reads back that each
stands still, and ends what it was doing. If one may still move, or a drive is lost, nothing beats any more.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Protocol, TypeVar

from labrig.clock import Clock
from labrig.devices.axis import Axis, AxisReadback
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


def _do_nothing() -> None:
    """There is nothing to begin anew."""


@dataclass(frozen=True)
class Check:
    """One thing that is watched.

    Parameters
    ----------
    look : callable
        Looks, and raises what is found; called at each step.
    reset : callable
        Begins anew, as power is going to be switched on; raises what must keep it off.
    needs_power : bool
        Whether it is left out while no drive has power.
    """

    look: Callable[[], object]
    reset: Callable[[], object] = _do_nothing
    needs_power: bool = True


class Judge(Protocol):
    """Judges each reading of the axes."""

    def on_reading(self, reading: Reading) -> None:
        """Raise what is found."""


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
        self._looks = tuple(check.look for check in checks)
        self._looks_without_power = tuple(check.look for check in checks if not check.needs_power)
        self.has_power = False

    def step(self) -> None:
        """Look at everything once. Raises `InterruptedRunError`, `SafetyStopError`, `BusError`, `DriveError`."""
        for look in self._looks if self.has_power else self._looks_without_power:
            look()

    def reset(self) -> None:
        """Begin anew before power is switched on. Raises what must keep it off, as `step`."""
        for check in self._checks:
            check.reset()


class Requests:
    """Nobody wants the run to end.

    Attributes
    ----------
    heeded : callable or None
        Returns a signal that has arrived; None while none is heeded.
    """

    def __init__(self, heeded: Interrupted | None) -> None:
        self.heeded = heeded

    def look(self) -> None:
        """Raise `InterruptedRunError` after a signal."""
        signal = None if self.heeded is None else self.heeded()
        if signal is not None:
            raise InterruptedRunError(f"interrupted by {signal}")


class Readings:
    """Reads the axes while nobody else does, and remembers where each was last.

    Parameters
    ----------
    axes : mapping of str to Axis
        The open axes.
    clock : Clock
        Rig time.
    judges : sequence of Judge
        Judge each reading.

    Attributes
    ----------
    last_s : float
        When the axes were read last [s].
    positions : mapping of str to tuple of float
        Axis -> when it was read last [s], and where it was [mm or rad].
    """

    def __init__(self, axes: Mapping[str, Axis], clock: Clock, judges: Sequence[Judge]) -> None:
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


class Positions:
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


class Targets:
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


class Inputs:
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


class Stalls:
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


class RigSupervisor(Supervisor):
    """Supervises an opened rig.

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
        self.readings = Readings(axes, heartbeat, (self.positions, Targets(axes), *inputs, self.stalls))

        def look_at_drives() -> None:
            for axis in axes.values():
                axis.drive.check()

        def read_inputs() -> None:
            for each in inputs:
                each.reset()

        super().__init__(
            (
                Check(heartbeat.require_awake, needs_power=False),
                Check(watch.link.require_works, needs_power=False),
                Check(self.requests.look, needs_power=False),
                # A program that only asks keeps power off too: it is about to command.
                Check(watch.require_no_command, watch.require_free),
                Check(look_at_drives, needs_power=False),
                Check(watch.require_operational, watch.forget_states),
                Check(heartbeat.beat, needs_power=False),
                Check(self.readings.look, read_inputs),
                Check(self.stalls.look, self.stalls.reset),
            )
        )
