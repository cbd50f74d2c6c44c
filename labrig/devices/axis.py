"""One axis of the rig: its limits, its reference and its moves, for any kind of drive."""

from collections.abc import Iterator
from dataclasses import replace

from labrig.clock import Clock
from labrig.devices.axis_description import AxisDescription, refuse_unreferenced
from labrig.devices.drives.cia402 import Cia402Drive
from labrig.devices.drives.drive import DriveReading, Homing, Setpoint
from labrig.devices.position_supervision import (
    AT_REST,
    Expected,
    PositionReading,
    PositionWatch,
    expect_move,
    expect_rest,
)
from labrig.errors import TARGET_CHANGED, DriveError, DriveStrayedError, LimitError

_STOP_MARGIN_S = 0.5
_MOVE_MARGIN_S = 2.0

_SAME_TARGET = 1e-6
"""Targets that differ by less are the same [mm or rad]."""


class Axis:
    """One axis; made by `open_rig`.

    Parameters
    ----------
    name : str
        insertion, rotation or linear.
    description : AxisDescription
        Its section of the rig file; complete.
    drive : Cia402Drive
        Its drive.
    clock : Clock
        Rig time, which bounds moves.

    Attributes
    ----------
    expected : Expected or None
        What the axis has to do; None while nobody can tell, as in a homing.
    last : PositionReading or None
        The last reading that was judged; None if its zero is another one by now.
    sent_target : float or None
        Target that was last sent [mm or rad]; None if it is not known.
    """

    def __init__(self, name: str, description: AxisDescription, drive: Cia402Drive, clock: Clock) -> None:
        self.name = name
        self.unit = description.unit
        self.limits = description.limits
        self.max_speed = description.max_speed
        self.lag_s = description.lag_s
        self.referenced = False
        self.assumed = False
        self.description = description
        self.drive = drive
        self._clock = clock
        self._window_s = description.position_window_time_ms / 1000
        self._watch = PositionWatch(name, description)
        self.expected: Expected | None = AT_REST
        self.last: PositionReading | None = None
        self.sent_target: float | None = None
        self._then: tuple[float, float] | None = None
        self._due_s: float | None = None
        self._inside_since_s: float | None = None

    @property
    def speed(self) -> float:
        """Highest speed of the move that it makes [mm/s or rad/s]; 0 at rest and while it homes."""
        return 0.0 if self.expected is None else self.expected.speed

    # Moving

    def start_move(self, position: float, speed: float) -> Setpoint:
        """Start a move and return at once; `read` and `Rig.read_states` tell when it is done.

        Parameters
        ----------
        position : float
            Where to, absolute [mm or rad].
        speed : float
            How fast [mm/s or rad/s].

        Raises
        ------
        LimitError
            Before anything is sent.
        SafetyStopError
            When the axis has neither a reference nor an assumed position.
        DriveError, BusError
        """
        self.description.check_move(self.name, position, speed)
        if not (self.referenced or self.assumed):
            raise refuse_unreferenced(self.name)
        self._start(position, speed, self._beyond(position))
        return self.drive.round_move(position, speed)

    def start_jog(self, distance: float, speed: float) -> None:
        """Start a relative move, referenced or not; `read` tells when it is done.

        Backlash is not compensated. The limits of the rig file hold if the axis has a reference.

        Parameters
        ----------
        distance : float
            How far [mm or rad].
        speed : float
            How fast at most [mm/s or rad/s].

        Raises
        ------
        LimitError
            Before anything is sent.
        DriveError, BusError
        """
        achieved = self.description.nearest_speed(min(speed, self.max_speed))
        target = self.drive.position() + distance
        if self.referenced:
            self.description.check_move(self.name, target, achieved)
        self._start(target, achieved, None)

    def _beyond(self, position: float) -> float | None:
        """Return where a downward move turns round, so that it ends from below; None if it need not.

        Raises
        ------
        LimitError
            When that is beyond the lower limit: the move would end from above, off by the backlash.
        """
        backlash, low = self.description.backlash, self.limits[0]
        if not backlash or position >= self.drive.position():
            return None
        if position - backlash < low:
            raise LimitError(
                f"axis {self.name}: {position:g} {self.unit} is {position - low:.3g} above its lower limit, and a move "
                f"from above passes its target by the backlash, {backlash:g} {self.unit}",
                f"ask for {low + backlash:g} {self.unit} or more, or lower the limit where the mechanics allow it",
            )
        return position - backlash

    def _start(self, target: float, speed: float, beyond: float | None) -> None:
        """Start a move, by way of where it turns round."""
        self._then = None if beyond is None else (target, speed)
        self._go((self._clock.now_s(), self.drive.position()), target if beyond is None else beyond, speed)

    def _go(self, here: tuple[float, float], goal: float, speed: float) -> None:
        """Send a move, from where the axis was read at an instant [s] or later [mm or rad]."""
        self._inside_since_s = self._due_s = None
        self.drive.start_move(goal, speed)
        move = self.drive.round_move(goal, speed)
        self.sent_target = move.position
        self.expected = expect_move(
            self.description,
            self.expected,
            here[1],
            (move.position, move.speed),
            (here[0], self._clock.now_s()),
        )
        self._due_s = self.expected.profile.end_s + self._window_s + _MOVE_MARGIN_S

    def read(self, since_s: float | None = None) -> DriveReading:
        """Read statusword and position, as `Cia402Drive.read`.

        `target_reached` means that the last move is done: the drive says so, and the position that was read
        is within the window around the target.

        Raises
        ------
        DriveError
            On a fault, a restart, silence, lost power, or a move that is long overdue.
        BusError
        """
        read = self.drive.read(since_s)
        reached = self._has_arrived(arrived=read.target_reached)
        if reached and self._then is not None:
            (target, speed), self._then = self._then, None
            self._go((self._clock.now_s(), read.position), target, speed)
            reached = False
        if reached:
            self._due_s = None
            if self.expected is not None and self.expected.speed:
                self.expected = expect_rest(self.expected.profile.end_position)
        elif self._due_s is not None and self._inside_since_s is None and self._clock.now_s() > self._due_s:
            raise DriveError(
                f"axis {self.name} stands at {read.position:.4g} {self.unit} "
                "and has not arrived in good time",
                "look for what blocks it; see position_window in the rig file",
            )
        return read if reached == read.target_reached else replace(read, target_reached=reached)

    def judge(self, reading: PositionReading) -> DriveStrayedError | None:
        """Return the error of a reading at which the axis is not where it has to be."""
        last, self.last = self.last, reading
        if self.expected is AT_REST:
            self.expected = expect_rest(reading.position)
        return None if self.expected is None else self._watch.judge(self.expected, last, reading)

    def require_target(self) -> None:
        """Require that the drive has the target that was last sent; the first that is read after homing counts as sent.

        Raises `DriveStrayedError`, `DriveError`, `BusError`.
        """
        found = self.drive.target()
        if self.sent_target is None:
            self.sent_target = found
        if abs(found - self.sent_target) > _SAME_TARGET:
            raise DriveStrayedError(
                f"the drive of axis {self.name} has the target {found:.4f} {self.unit}, "
                f"and {self.sent_target:.4f} {self.unit} was sent",
                "find the other program on the bus that commands it, and end it",
                fault=TARGET_CHANGED,
            )

    def _has_arrived(self, *, arrived: bool) -> bool:
        """Tell whether every reading during the window time said so, with its position in the window."""
        if not self.speed:
            return True
        now_s = self._clock.now_s()
        if not arrived:
            self._inside_since_s = None
            return False
        if self._inside_since_s is None:
            self._inside_since_s = now_s
        return now_s - self._inside_since_s >= self._window_s

    # Stopping

    def halt(self, *, quick: bool = False) -> None:
        """Start to decelerate, then hold; a quick stop leaves operation enabled. Raises `DriveError`, `BusError`."""
        self._due_s = self._then = None
        self.expected = AT_REST
        self.drive.stop(quick=quick)

    def wait_until_still(self) -> Iterator[None]:
        """Poll the position until the axis stands still; quick-stop it if halting does not suffice.

        Raises
        ------
        DriveError
            When it still moves, or does not answer.
        BusError
        """
        try:
            yield from self.drive.wait_until_still(self._stop_time_s(self.description.acceleration))
        except DriveError:
            self.drive.stop(quick=True)
            again_s = self._stop_time_s(self.description.quick_stop_deceleration)
            yield from self.drive.wait_until_still(again_s)

    def _stop_time_s(self, deceleration: float) -> float:
        return self.max_speed / deceleration + _STOP_MARGIN_S

    # Reference

    def home(self, homing: Homing) -> Iterator[None]:
        """Home, then give the drive the limits, which apply from now on; the caller lets time pass at each turn.

        Until it has ended, the axis has no reference and no limits. Raises `DriveError`, `BusError`.
        """
        self.referenced = self.assumed = False
        self._due_s = self._then = self.expected = self.sent_target = None
        self.drive.set_limits(None)
        yield from self.drive.home(homing)
        self.referenced = True
        self._rest_anew()
        self.drive.set_limits(self.limits)

    def assume_position(self, position: float) -> None:
        """Assume that the axis is at `position` [mm or rad], as a person has confirmed, for a withdrawal.

        Nothing is homed: the drive keeps its counter, and the axis stays without a reference. Limits of the drive that
        refer to another zero are removed; those of the rig file apply.

        Raises `DriveError`, `BusError`.
        """
        self.drive.set_limits(None)
        self.drive.assume_position(position)
        self._rest_anew()
        self._then = self._due_s = None
        self.assumed = True

    def _rest_anew(self) -> None:
        """Stand where the axis is, with a position and a target that count from another zero than before."""
        self.expected, self.sent_target = AT_REST, None
        self.last = None

    def snapshot(self, *, has_power: bool) -> dict[str, object]:
        """Return position and state, ready for JSON; the position alone while power is off."""
        if not has_power:
            return {f"position_{self.unit}": self.drive.position()}
        read = self.read()
        return {f"position_{self.unit}": read.position, "statusword": read.statusword}

    def describe(self) -> dict[str, object]:
        """Return the conversion of the axis and its drive, for the record."""
        return {"unit": self.unit, **self.drive.describe()}
