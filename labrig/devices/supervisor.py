"""What is watched while a rig is open, how often, and what each finding does: all of it stands in this file.

`Supervisor.step` goes through the checks below from top to bottom. Whoever lets rig time pass calls it again and again,
at least once in a period of the heartbeat: `Rig.wait`, a question, and everything that is done aside. One thread does
so, and it alone sends the heartbeat: a labrig that hangs, is stopped or is killed sends none, and the drives stop by
themselves.

======================  ====================================  =======================  ========================
check                   watches                               looks                    raises
======================  ====================================  =======================  ========================
the link works          errors of the CAN adapter             at each step             `BusError`
no request to end       signals; `devices stop` is SIGTERM    at each step, unless     `InterruptedRunError`
                                                              told not to
no foreign command      commands of another program           at each step with power  `SecondMasterError`
drives                  emergencies, boot-ups, heartbeats     at each step             `DriveError`
operational             the NMT state of each drive           at each step with power  `DriveStrayedError`
the beat                nothing: it sends the heartbeat       at each step, when due   `BusError`
a reading               nothing: it reads the axes            after `LOOK_S` unread    `DriveError`, `BusError`
`PositionWatch`         where each axis is                    at each reading          `DriveStrayedError`
targets                 which target each drive has           at a reading, each       `DriveStrayedError`
                                                              `LOOK_S`
inputs                  inputs with limits                    at each reading          `ForceGuardError`
`StallWatch`            current and following error           the faster the axis,     `ForceGuardError`
                                                              the more often
======================  ====================================  =======================  ========================

Whatever is found, `Rig` does the same: it posts a halt to every axis before it awaits any answer (a quick stop where
an axis strays or obeys another program), reads back that each stands still, and ends what it was doing. If one may
still move, or a drive is lost, nothing beats any more.
"""

import math
from collections.abc import Callable, Mapping

from labrig.devices.axis import Axis
from labrig.devices.bus_watch import BusWatch
from labrig.devices.drives.drive import DriveReading, raise_together
from labrig.devices.heartbeat import HeartbeatClock
from labrig.devices.opening import Opening
from labrig.devices.position_supervision import PositionReading
from labrig.devices.stall import StallWatch
from labrig.errors import POSITION_JUMPED, InterruptedRunError

_SYNC = 0x080

LOOK_S = 0.15
"""Axes that nobody has read for so long are read; targets are read back so often [s]."""

Interrupted = Callable[[], str | None]
"""Returns the name of a signal that has arrived, or None."""


class Supervisor:
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

    Attributes
    ----------
    has_power : bool
        Whether power is on, or may be.
    heeded : callable or None
        Returns a signal that has arrived; None while none is heeded.
    last_s : float
        When the axes were read last [s].
    jumped : set of str
        Axes whose position has jumped: nobody knows their zero.
    """

    def __init__(
        self,
        axes: Mapping[str, Axis],
        watch: BusWatch,
        heartbeat: HeartbeatClock,
        interrupted: Interrupted,
        opening: Opening,
    ) -> None:
        self.has_power = False
        self.heeded: Interrupted | None = interrupted
        self.last_s = 0.0
        self.jumped: set[str] = set()
        self._axes = axes
        self._watch = watch
        self._heartbeat = heartbeat
        self._opening = opening
        self._stalls: dict[str, StallWatch] = {}
        self._targets_due = list(axes.values())
        self._targets_read_s = 0.0

    def reset(self) -> None:
        """Begin anew before power is switched on. Raises what must keep it off, as `step`."""
        # A program that only asks keeps power off too: it is about to command.
        self._watch.require_free()
        self._require_inputs({name: axis.drive.reports.read_inputs() for name, axis in self._axes.items()})
        self._stalls = {}
        for name, axis in self._axes.items():
            limit_ma = None if self._opening.limit_ma(axis) is None else axis.drive.reports.current_limit_ma()
            if (
                limit_ma is not None
                and axis.drive.reports.lag() is not None
                and axis.drive.reports.current_ma() is not None
            ):
                self._stalls[name] = StallWatch(axis, limit_ma)

    def step(self) -> None:
        """Look at everything once. Raises `InterruptedRunError`, `SafetyStopError`, `BusError`, `DriveError`."""
        self._watch.link.require_works()
        signal = None if self.heeded is None else self.heeded()
        if signal is not None:
            raise InterruptedRunError(f"interrupted by {signal}")
        if self.has_power:
            self._watch.require_no_command()
        for axis in self._axes.values():
            axis.drive.check(operational=self.has_power)
        self._heartbeat.beat()
        if self.has_power and self._heartbeat.now_s() - self.last_s >= LOOK_S:
            self.read(go_on=False)
        for stall in self._stalls.values() if self.has_power else ():
            stall.look(self._heartbeat.now_s())

    @property
    def period_s(self) -> float:
        """How often the axes in motion have to be looked at [s]."""
        return min((stall.period_s for stall in self._stalls.values()), default=math.inf)

    def read(self, *, go_on: bool = True) -> dict[str, DriveReading]:
        """Read every axis at one instant, that of a SYNC, and judge what is read; by `go_on` a move may turn round.

        Raises
        ------
        DriveStrayedError, ForceGuardError, DriveError, BusError
        """
        self.last_s = self._heartbeat.now_s()  # before the SYNC: a busy computer may be held up later
        self._watch.link.send(_SYNC, b"")
        states = {
            name: (axis if go_on else axis.drive).read(self.last_s) for name, axis in self._axes.items()
        }
        until_s = self._heartbeat.now_s()
        readings = {
            name: PositionReading(self.last_s, until_s, each.position) for name, each in states.items()
        }
        strays = [stray for name, axis in self._axes.items() if (stray := axis.judge(readings[name]))]
        self.jumped |= {stray.axis for stray in strays if stray.fault is POSITION_JUMPED}
        raise_together(strays)
        self._require_targets()
        self._require_inputs({name: state.inputs for name, state in states.items() if state.inputs})
        return states

    def _require_targets(self) -> None:
        """Read back, if it is time to, the targets of axes in motion; where none moves, of one after another."""
        if self.last_s - self._targets_read_s < LOOK_S:
            return
        self._targets_read_s = self.last_s
        self._targets_due.append(self._targets_due.pop(0))
        moving = [axis for axis in self._axes.values() if axis.speed]
        for axis in moving or self._targets_due[:1]:
            axis.require_target()

    def _require_inputs(self, inputs: Mapping[str, Mapping[str, float | bool]]) -> None:
        """Raise the `ForceGuardError`s of all inputs beyond their limits, where limits hold."""
        excesses = [
            self._axes[name].description.inputs[channel].find_excess(channel, name, value)
            for name, values in inputs.items()
            for channel, value in values.items()
        ]
        if self._opening.hold_inputs:
            raise_together([excess for excess in excesses if excess is not None])
