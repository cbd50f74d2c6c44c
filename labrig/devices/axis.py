"""One axis of the rig, in mm or rad: limits, conversion and what a move is, over the driver of its drive."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from labrig.clock import Clock
from labrig.devices import epos2_objects as od
from labrig.devices.cia402 import TARGET_REACHED, DriveState, Goal, decode_state
from labrig.devices.drive_settings import drive_settings, fingerprint
from labrig.devices.epos2 import Epos2, Identity
from labrig.devices.homing import HOMING_DIRECTIONS, Homing
from labrig.devices.rig_file import AxisDescription, HeartbeatDescription, HomingDescription, check_move
from labrig.errors import DriveError, DriveFaultError, MachineError, SafetyStopError

_STOP_MARGIN_S = 0.5
_MOVE_MARGIN_S = 2.0
_MOVE_MARGIN_FRACTION = 0.2


@dataclass(frozen=True)
class Setpoint:
    """A move as it was asked and as it was sent.

    Parameters
    ----------
    asked_position, asked_speed : float
        What was asked [mm or rad, per s].
    sent_quadcounts, sent_rpm : int
        What went over the wire.
    position, speed : float
        What that is [mm or rad, per s]; off by rounding.
    """

    asked_position: float
    asked_speed: float
    sent_quadcounts: int
    sent_rpm: int
    position: float
    speed: float


@dataclass(frozen=True, slots=True)
class AxisReadback:
    """What an axis read: position and speed [mm or rad, per s], statusword, its state, and whether the move is done.

    The speed is that between this position and the one read before; the drive's own is quantised to tens of
    rpm.
    """

    position: float
    speed: float
    statusword: int
    state: DriveState
    target_reached: bool


def raise_together(failures: Sequence[MachineError]) -> None:
    """Raise the first failure with the messages of all, if there are any."""
    if failures:
        raise failures[0].reworded("; ".join(failure.message for failure in failures))


class Axis:
    """One axis; made by `open_rig`.

    Parameters
    ----------
    name : str
        insertion, rotation or linear.
    description : AxisDescription
        Its section of the rig file; complete.
    drive : Epos2
        Its drive.
    clock : Clock
        Whose time bounds moves.
    heartbeat : HeartbeatDescription
        When the drive stops by itself.
    max_current_ma : int or None
        Output current beyond which the drive does not go while this axis is open; None leaves its own limit.
    """

    def __init__(
        self,
        name: str,
        description: AxisDescription,
        drive: Epos2,
        clock: Clock,
        heartbeat: HeartbeatDescription,
        *,
        max_current_ma: int | None = None,
    ) -> None:
        self.name = name
        self.unit = description.unit
        self.limits = description.limits
        self.max_speed = description.max_speed
        self.lag_s = description.lag_s
        self.referenced = False
        self.believed = False
        self._offset_quadcounts = 0
        self._description = description
        self._scale = description.scale()
        self._window_quadcounts = self._scale.to_distance_quadcounts(description.position_window)
        self._drive = drive
        self._clock = clock
        self._target: int | None = None
        self._then: tuple[int, int] | None = None
        self._due_s: float | None = None
        self._inside_since_s: float | None = None
        self._last: tuple[float, float] | None = None
        self._heartbeat = heartbeat
        self._max_current_ma = max_current_ma
        self._own_current_ma: int | None = None
        self.written: tuple[str, ...] = ()

    # Moving

    def check_move(self, position: float, speed: float) -> None:
        """Refuse a move beyond the limits of this axis, or one whose speed integer rpm would change too much.

        Raises
        ------
        LimitError
        """
        check_move(self.name, self._description, position, speed)

    def nearest_speed(self, speed: float) -> float:
        """Return the fastest speed of this axis, in integer rpm of its motor, that is no faster than `speed`."""
        return self._scale.to_speed(max(1, math.floor(speed * self._scale.rpm_per_speed)))

    def start_move(self, position: float, speed: float) -> Setpoint:
        """Start a move and return at once; `read` and `Rig.read_states` say when it is done.

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
            When the axis is not referenced, so that no position means anything, and none is believed.
        DriveError, BusError
        """
        self.check_move(position, speed)
        if not (self.referenced or self.believed):
            raise SafetyStopError(
                f"axis {self.name} is not referenced: nobody knows where it stands",
                f"first: labrig devices home --axis {self.name} --rig FILE",
            )
        target, rpm = self._counter(position), self._scale.to_rpm(speed)
        achieved = self._scale.to_speed(rpm)
        self._due_s = self._clock.now_s() + self._longest_s(target, achieved)
        self._go(target, rpm, self._beyond(position))
        return Setpoint(position, speed, target, rpm, self._position(target), achieved)

    def start_jog(self, distance: float, speed: float) -> float:
        """Start a move by a distance from where the axis stands, referenced or not; `read` says when it is done.

        Backlash is not compensated. Limits of the rig file hold where the axis has a reference.

        Parameters
        ----------
        distance : float
            How far [mm or rad].
        speed : float
            How fast at most [mm/s or rad/s].

        Returns
        -------
        float
            The speed that integer rpm give [mm/s or rad/s].

        Raises
        ------
        LimitError
            Before anything is sent.
        DriveError, BusError
        """
        counter = self._drive.position()
        achieved = self.nearest_speed(min(speed, self.max_speed))
        if self.referenced:
            self.check_move(self._position(counter) + distance, achieved)
        target = self._counter(self._position(counter) + distance)
        self._due_s = self._clock.now_s() + self._longest_s(target, achieved)
        self._go(target, self._scale.to_rpm(achieved), None)
        return achieved

    def _beyond(self, position: float) -> int | None:
        """Return where a move downwards turns round, so that it ends from below; None for one that need not."""
        here = self._position(self._drive.position())
        if not self._description.backlash or position >= here:
            return None
        return self._counter(max(position - self._description.backlash, self.limits[0]))

    def _counter(self, position: float) -> int:
        """Return what the drive's counter reads at a position."""
        return self._scale.to_quadcounts(position) - self._offset_quadcounts

    def _position(self, counter: int) -> float:
        """Return the position at which the drive's counter reads this."""
        return self._scale.to_position(counter + self._offset_quadcounts)

    def _go(self, target: int, rpm: int, beyond: int | None) -> None:
        self._inside_since_s = None
        self._target = target if beyond is None else beyond
        self._then = None if beyond is None else (target, rpm)
        self._drive.start_move(self._target, rpm)

    def _longest_s(self, target: int, speed: float) -> float:
        """Return after how long a move must be done: its own time, window time and a margin."""
        distance = abs(self._scale.to_position(target - self._drive.position()))
        distance += 2 * self._description.backlash
        ramps_s = 4 * speed / self._description.acceleration
        window_s = self._description.position_window_time_ms / 1000
        return (distance / speed + ramps_s) * (1 + _MOVE_MARGIN_FRACTION) + window_s + _MOVE_MARGIN_S

    def expect_report(self) -> None:
        """Let the next `read` return what the drive reports at the SYNC that is about to be sent."""
        self._drive.expect_report()

    def read(self) -> AxisReadback:
        """Read statusword and position.

        `target_reached` means that the last move is done: the drive says so, and the position that was read
        stands within the window around the target.

        Raises
        ------
        DriveError
            On a fault, a restart, silence, lost power, or a move that is not done long after it should be.
        BusError
        """
        statusword, quadcounts = self._drive.report()
        self._drive.refuse_unless_enabled(statusword)
        reached = self._has_arrived(statusword, quadcounts)
        if reached and self._then is not None:
            target, rpm = self._then
            self._go(target, rpm, None)
            reached = False
        if reached:
            self._due_s = None
        elif self._due_s is not None and self._clock.now_s() > self._due_s:
            raise DriveError(
                f"axis {self.name} stands at {self._position(quadcounts):.4g} {self.unit} "
                "and has not arrived in good time",
                "look for what blocks it; see position_window in the rig file",
            )
        position = self._position(quadcounts)
        return AxisReadback(position, self._speed(position), statusword, decode_state(statusword), reached)

    def _has_arrived(self, statusword: int, quadcounts: int) -> bool:
        """Tell whether the drive says so, and every position read for the window time was inside the window."""
        if self._target is None:
            return True
        now_s = self._clock.now_s()
        if not statusword & TARGET_REACHED or abs(quadcounts - self._target) > self._window_quadcounts:
            self._inside_since_s = None
            return False
        if self._inside_since_s is None:
            self._inside_since_s = now_s
        return now_s - self._inside_since_s >= self._description.position_window_time_ms / 1000

    def _speed(self, position: float) -> float:
        """Return the speed since the position before this one; zero for the first."""
        now_s = self._clock.now_s()
        then_s, before = self._last or (now_s, position)
        self._last = (now_s, position)
        return (position - before) / (now_s - then_s) if now_s > then_s else 0.0

    def check(self) -> None:
        """Raise the `DriveError` of a fault or restart that the drive has reported by itself; ask nothing."""
        self._drive.raise_if_reported()

    # Stopping

    def call_halt(self) -> None:
        """Tell the drive to halt and wait for no answer: a silent one holds up no other. Raises `BusError`."""
        self._drive.call_halt()

    def halt(self) -> None:
        """Begin to decelerate, and hold. Raises `DriveError`, `BusError`."""
        self._due_s = self._then = None
        self._drive.halt()

    def looks_until_still(self) -> Iterator[None]:
        """Look until the axis stands still, as its position reads; quick-stop it when halting does not do.

        Raises
        ------
        DriveError
            When it still moves, or does not answer.
        BusError
        """
        try:
            yield from self._drive.looks_until_still(self._stop_time_s(self._description.acceleration))
        except DriveError:
            self._drive.quick_stop()
            again_s = self._stop_time_s(self._description.quick_stop_deceleration)
            yield from self._drive.looks_until_still(again_s)

    def _stop_time_s(self, deceleration: float) -> float:
        return self.max_speed / deceleration + _STOP_MARGIN_S

    # Connecting

    def connect(self) -> Identity:
        """Verify that the drive is the one of the rig file; nothing is written.

        Raises
        ------
        DriveError, BusError
        """
        identity = self._drive.identify()
        failures = []
        try:
            self._drive.require_encoder(self._scale.encoder_pulses_per_turn)
        except DriveError as error:
            failures.append(error)
        try:
            self._require_fingerprint()
        except DriveError as error:
            failures.append(error)
        raise_together(failures)
        return identity

    def _require_fingerprint(self) -> None:
        if self._description.configuration_fingerprint is not None:
            self._drive.require_fingerprint(self._description.configuration_fingerprint)

    def configure(self) -> None:
        """Give the drive its settings, held off; heartbeats are watched from here. Raises `DriveError`, `BusError`."""
        self._drive.hold_off()
        self._drive.watch(self._heartbeat.period_ms, self._heartbeat.timeout_ms / 1000)
        self.written = self._configure(self._settings() | self._gentle())
        self._drive.let_report()

    def _gentle(self) -> dict[od.Entry, int]:
        """Return the current limit of this opening, where it has one below the drive's own."""
        if self._max_current_ma is None:
            return {}
        self._own_current_ma = self._drive.read(od.MAX_CURRENT)
        return {od.MAX_CURRENT: min(self._max_current_ma, self._own_current_ma)}

    def _configure(self, settings: dict[od.Entry, int]) -> tuple[str, ...]:
        ours = fingerprint(self._settings())
        return self._drive.configure(settings, self._description.configuration_fingerprint or ours)

    def reported_fault(self) -> DriveFaultError | None:
        """Return the fault in which its drive is; None when it is in none. Raises `DriveError`, `BusError`."""
        return self._drive.reported_fault()

    def reset_fault(self) -> None:
        """Reset the fault of its drive, as a person has confirmed. Raises `DriveError`, `BusError`."""
        self._drive.reset_fault()

    def cob_ids(self) -> tuple[frozenset[int], frozenset[int]]:
        """Return the COB-IDs of process data that the drive sends, and that it obeys."""
        return self._drive.pdo_cob_ids(), self._drive.command_cob_ids()

    def enable(self) -> None:
        """Switch the power stage on; the axis holds where it is. Raises `DriveError`, `BusError`."""
        self._drive.enable()

    def release(self) -> None:
        """Switch the power stage off, and give the drive its current limit back. Raises `DriveError`, `BusError`."""
        self._drive.go_to(Goal.POWER_OFF)
        if self._own_current_ma is not None:
            self._drive.adjust({od.MAX_CURRENT: self._own_current_ma})
        self._drive.unwatch()

    def is_referenced_in_drive(self) -> bool:
        """Tell whether the drive has kept its reference since it was set. Raises `DriveError`, `BusError`."""
        return self._drive.is_referenced()

    def homing_direction(self, method: int) -> int:
        """Return which way this axis goes in the search of a method: -1 back, +1 forwards, 0 not at all."""
        return -HOMING_DIRECTIONS[method] if self._description.reversed else HOMING_DIRECTIONS[method]

    @property
    def homing(self) -> HomingDescription:
        """How the rig file has this axis homed."""
        return self._description.homing

    def homing_by(self, method: int) -> Homing:
        """Return a homing by this method as the rig file has it, in the units of the drive."""
        described, scale = self._description.homing, self._scale
        offset = round(described.offset * scale.quadcounts_per_unit)
        return Homing(
            method,
            offset=-HOMING_DIRECTIONS[method] * offset,
            position=scale.to_quadcounts(described.position),
            switch_rpm=scale.to_rpm(described.speed),
            index_rpm=max(1, scale.to_rpm(described.speed) // 10),
            rpm_per_s=scale.to_rpm_per_s(self._description.acceleration),
            current_threshold_ma=described.current_threshold_ma,
            timeout_s=described.timeout_s,
        )

    def start_homing(self, homing: Homing) -> None:
        """Begin to look for home, without a reference and its limits until `finish_homing`.

        Raises
        ------
        DriveError, BusError
        """
        self.referenced = self.believed = False
        self._offset_quadcounts = 0
        self._due_s = self._then = None
        self._free_limits()
        self._drive.start_homing(homing)

    def has_homed(self) -> bool:
        """Tell whether home has been found.

        Raises
        ------
        DriveError
            When it cannot be found, or not in time.
        BusError
        """
        return self._drive.has_homed()

    def finish_homing(self, homing: Homing) -> None:
        """Hold at home, and give the drive the limits, which mean something from now on.

        Raises
        ------
        DriveError, BusError
        """
        self._drive.finish_homing(homing)
        self.referenced = True
        self._target = None
        self.set_limits()

    def believe_position(self, position: float) -> None:
        """Take the axis to stand at `position` [mm or rad], as a person has confirmed, for a withdrawal.

        Nothing is homed: the drive keeps its counter, and the axis stays without a reference. Limits that the
        drive may have from another zero are taken off; those of the rig file hold here.

        Raises
        ------
        DriveError, BusError
        """
        self._free_limits()
        self._offset_quadcounts = self._scale.to_quadcounts(position) - self._drive.position()
        self._target = self._then = self._due_s = None
        self.believed = True

    def _settings(self) -> dict[od.Entry, int]:
        return drive_settings(self._description, self._heartbeat)

    def _free_limits(self) -> None:
        """Take limits of an earlier reference off the drive: they would refer to another zero."""
        self._drive.adjust({entry: entry.default for entry in (od.LOWER_LIMIT, od.UPPER_LIMIT)})

    def set_limits(self) -> None:
        """Give the drive the limits of the rig file, wider by the position window: one count beyond is a fault to it.

        They mean something only while the axis is referenced. Raises `DriveError`, `BusError`.
        """
        low, high = sorted(map(self._scale.to_quadcounts, self.limits))
        limits = {
            od.LOWER_LIMIT: low - self._window_quadcounts,
            od.UPPER_LIMIT: high + self._window_quadcounts,
        }
        self._configure(limits)

    def counts(self) -> dict[str, int]:
        """Return how often the drive had to be asked again, and answers of it that nobody had asked for."""
        return self._drive.counts()

    def describe(self) -> dict[str, object]:
        """Return how the axis converts, for the record."""
        return {
            "unit": self.unit,
            "node_id": self._drive.node_id,
            "quadcounts_per_unit": self._scale.quadcounts_per_unit,
            "rpm_per_speed": self._scale.rpm_per_speed,
            "position_window_quadcounts": self._window_quadcounts,
            # Each was read back when the drive was configured; those that the drive had otherwise were written.
            "drive_settings": {
                entry.place: value for entry, value in (self._settings() | self._gentle()).items()
            },
            "settings_written": list(self.written),
            **self.counts(),
        }
