"""The driver of CiA 402 drives in profile position mode over CANopen; a `Model` tells what a product has of its own.

What is decided here
--------------------
- SDO goes through our own client. `canopen`'s `BaseNode402` is not used: it resets faults and enables power by itself,
  and its signs of homing methods are wrong for maxon.
- Nothing counts until it has been read back: each setting after writing, both edges of the set-point acknowledge, the
  position at the end of a move, standstill after a stop. A value out of the range of the EDS file is not sent.
- Only `enable` switches power on. It sets Halt and takes the actual position as target, so nothing moves until a move
  is commanded. Only `reset_fault` resets a fault, after a person has confirmed.
- A lost heartbeat, a fault and a quick stop have option codes; all are set. CiA 402 allows 0 in 0x6007, with which the
  axis would keep moving.
- Uncertain until tried on a device: whether bit 12 falls when homing starts, as a fresh attained bit requires (if not,
  homing ends in its timeout with the axis halted); whether a drive accepts homing here by method 37 at once; whether a
  drive with 0x6007 = 1 goes to fault when its heartbeat ends.
"""

import math
from collections import deque
from collections.abc import Callable, Iterator

from labrig.clock import Clock
from labrig.devices.axis_description import AxisDescription
from labrig.devices.bus import CanLink
from labrig.devices.can_description import HeartbeatDescription
from labrig.devices.drives import objects as co
from labrig.devices.drives.drive import (
    HOMING_HERE,
    STILL_COUNTS,
    STILL_POLL_S,
    DriveReading,
    Homing,
    Setpoint,
    raise_together,
)
from labrig.devices.drives.eds import find_default
from labrig.devices.drives.node import (
    NMT_RESET_COMMUNICATION,
    NMT_START,
    NMT_STOPPED,
    DriveNode,
)
from labrig.devices.drives.objects import Place
from labrig.devices.drives.reports import DriveReports
from labrig.devices.drives.sdo import CHECK_POWER
from labrig.devices.drives.settings import list_homing_settings, list_settings
from labrig.devices.drives.states import (
    CHANGE_IMMEDIATELY,
    ENABLE,
    FAULT_RESET,
    FAULTED,
    HALT,
    HOMING_ATTAINED,
    HOMING_ERROR,
    NEW_SETPOINT,
    QUICK_STOP,
    SETPOINT_ACKNOWLEDGED,
    TARGET_REACHED,
    DriveState,
    TargetState,
    decode_state,
    is_attained,
    plan_controlword,
)
from labrig.errors import DriveError, DriveFaultError

POLL_S = 0.005
ANSWER_TIME_S = 1.0
"""Longest rig time to reach a state, acknowledge a set-point or finish homing at the present position."""

LONGEST_STILL_TIME_S = 0.4
"""Time for which a position must stay within the dither if the speed of the slowest creep is unknown [s]."""

_RESET_TIME_S = 0.05
"""Time that a drive gets to reset a fault."""


def still_time_s(slowest_counts_per_s: float | None) -> float:
    """Return the time for which a position must stay within `STILL_COUNTS` before an axis counts as still [s].

    In this time the slowest commandable speed moves the counter by more than the dither at both ends, so a creep never
    counts as standstill. The time is at most `LONGEST_STILL_TIME_S`, also if the speed is unknown (None); a slower
    creep is not noticed.
    """
    if slowest_counts_per_s is None:
        return LONGEST_STILL_TIME_S
    return min((2 * STILL_COUNTS + 1) / slowest_counts_per_s, LONGEST_STILL_TIME_S)


class Cia402Drive(DriveNode):
    """One drive.

    Parameters
    ----------
    link : CanLink
        The bus.
    section : AxisDescription
        Section of its axis in the rig file; may be incomplete, or name an EDS file that cannot be read.
    axis : str
        Name of its axis, for messages.
    clock : Clock
        Time for timeouts.
    """

    def __init__(self, link: CanLink, section: AxisDescription, axis: str, clock: Clock) -> None:
        super().__init__(link, section, axis, clock)
        slowest = None if section.unknown else self.scale.counts_per_turn / self.scale.speed_units
        self._readings_until_still = 1 + math.ceil(still_time_s(slowest) / STILL_POLL_S)
        self._offset_counts = 0
        self._target: int | None = None
        self._settings: dict[Place, int | None] = {}
        self._heartbeat: HeartbeatDescription | None = None
        self._own_limit: dict[Place, int] = {}
        self._was_enabled = self._has_homed = False
        self.reports = DriveReports(self, link)

    # Units

    def _counter(self, position: float) -> int:
        """Return the drive's counter at a position."""
        return self.scale.to_counts(position) - self._offset_counts

    def _position(self, counter: int) -> float:
        """Return the position at a value of the drive's counter."""
        return self.scale.to_position(counter + self._offset_counts)

    @property
    def _window_counts(self) -> int:
        return self.scale.to_distance_counts(self.section.position_window)

    # Connecting

    def find_excesses(self) -> Iterator[DriveError]:
        """Yield a current limit or a speed of the rig file above the drive's own."""
        section, place = self.section, self.model.motor_speed_limit
        own_speed = None if place is None else self.scale.to_speed(self.upload(place))
        for key, asked, own in (
            ("max_current_ma", section.max_current_ma, self.reports.current_limit_ma()),
            ("max_speed", section.nearest_speed(section.max_speed), own_speed),
        ):
            if asked is not None and own is not None and asked > own:
                yield DriveError(
                    f"{self.name} has a limit of {own:.6g}, the rig file says {key} {asked:.6g}",
                    f"write {own:.6g} or less, or raise the limit in {self.model.tool} if axis and motor bear it",
                )

    def configure(
        self, heartbeat: HeartbeatDescription, max_current_ma: int | None, own_ma: int | None = None
    ) -> None:
        """Stop the axis, switch power off, write the settings of its section, and make the drive stop by itself.

        From here on the drive sends heartbeats, and `check` notices when they stop. It stops when those of the computer
        do, and obeys no process data of anybody else. Each setting is read, written if it differs, and read back.

        Parameters
        ----------
        heartbeat : HeartbeatDescription
            Period, node id, and the silence after which the drive stops.
        max_current_ma : int or None
            Limit of the output current until `close` [mA]; None keeps its own limit.
        own_ma : int or None
            Its own limit, if a labrig that was killed has left another one there [mA].

        Raises
        ------
        DriveError
            On a fault, on limits of the rig file above the drive's own, and on a setting that it does not keep, among
            them an option that means "no action" on a lost heartbeat.
        """
        self._fingerprint = ()  # written back last
        found = self.read_fingerprint()
        self.send_nmt(NMT_START)
        self.check()
        self._refuse_fault(self._statusword())
        self.stop()
        self._settle()
        self._go_to(TargetState.POWER_OFF)
        if self.reports.current_limit and own_ma not in {None, self.reports.current_limit_ma()}:
            place, milliamperes = self.reports.current_limit
            self.adjust({place: round(own_ma / milliamperes)})
        raise_together([*self.find_excesses()])
        self._heartbeat = heartbeat
        self._watch(heartbeat)
        settings = list_settings(self.section, self.model) | self._limit_current(max_current_ma)
        self.adjust(settings)
        self.reports.switch_on()
        self._settings = {
            **settings,
            **self._make_stop_by_itself(heartbeat, reports=bool(self.reports.layout)),
        }
        self._fingerprint = found
        self.adjust(dict(zip(self.model.fingerprint, found, strict=True)))

    def _limit_current(self, max_current_ma: int | None) -> dict[Place, int]:
        """Return the setting that limits the current, and keep the drive's own for `close`."""
        if max_current_ma is None:
            return {}
        found = self.reports.current_limit
        if found is None:
            raise DriveError(
                f"{self.name} has no current limit that labrig can set, asked for {max_current_ma} mA",
                f"set it in {self.model.tool}; --current-ma 0, and a rig file without max_current_ma, ask for none",
            )
        place, milliamperes = found
        own = self.upload(place)
        self._own_limit = {place: own}
        return {place: min(math.floor(max_current_ma / milliamperes), own)}

    def describe(self) -> dict[str, object]:
        """Return settings of the drive and how often it answered amiss, for the record."""
        return {
            "drive_settings": {str(place): value for place, value in self._settings.items()},
            "retries": self.sdo.retries + self.reports.missed,
            "strays": self.sdo.strays + self.reports.strays,
        }

    def close(self) -> None:
        """Switch power off, restore the current limit, and end both heartbeats without a fault."""
        self._go_to(TargetState.POWER_OFF)
        self._silence_s = math.inf
        self.adjust({**self._own_limit, co.CONSUMER_HEARTBEAT: 0, co.PRODUCER_HEARTBEAT: 0})

    # States

    def _statusword(self) -> int:
        """Return the statusword, and remember whether it is that of an enabled drive."""
        statusword = self.upload(co.STATUSWORD)
        self._was_enabled = decode_state(statusword) is DriveState.OPERATION_ENABLED
        return statusword

    def _go_to(self, goal: TargetState) -> None:
        """Bring the drive to a goal of its state machine.

        Raises
        ------
        DriveError
            On a fault if it is to be enabled, or when it stays in a state, or returns to it, for too long.
        """
        since_s: dict[DriveState, float] = {}
        while True:
            statusword = self._statusword()
            state, now_s = decode_state(statusword), self._clock.now_s()
            if goal is TargetState.ENABLED:
                self._refuse_fault(statusword)
            if is_attained(state, goal):
                return
            if now_s - since_s.setdefault(state, now_s) > ANSWER_TIME_S:
                raise DriveError(
                    f"{self.name} stayed in {state.name} for {ANSWER_TIME_S:g} s "
                    f"on the way to {goal.name} (statusword 0x{statusword:04X})",
                    f"look at its status in {self.model.tool}",
                )
            controlword = plan_controlword(state, goal)
            if controlword is not None:
                self.download(co.CONTROLWORD, controlword)
            self._clock.sleep(POLL_S)

    def enable(self) -> None:
        """Switch the power stage on; the axis holds its position. Raises `DriveError`, also on a fault."""
        self._set_mode(co.PROFILE_POSITION)
        self.download(co.CONTROLWORD, HALT)
        self.download(co.TARGET_POSITION, self.upload(co.POSITION_ACTUAL))
        self._go_to(TargetState.ENABLED)

    def _set_mode(self, mode: int) -> None:
        """Set the mode of operation, and wait until the drive is in it."""
        self._ensure(co.MODE, mode)
        if self.model.has(co.MODE_DISPLAY):
            self._wait_until(lambda: self.upload(co.MODE_DISPLAY) == mode, f"enter mode of operation {mode}")

    def _wait_until(self, done: Callable[[], bool], what: str) -> None:
        deadline_s = self._clock.now_s() + ANSWER_TIME_S
        while not done():
            if self._clock.now_s() > deadline_s:
                raise DriveError(
                    f"{self.name} did not {what} within {ANSWER_TIME_S:g} s",
                    f"look at its status in {self.model.tool}",
                )
            self._clock.sleep(POLL_S)

    # Reading

    def position(self) -> float:
        """Return the position of the axis [mm or rad]."""
        return self._position(self.upload(co.POSITION_ACTUAL))

    def target(self) -> float:
        """Return the target position that the drive now has [mm or rad]."""
        return self._position(self.upload(co.TARGET_POSITION))

    def read(self, since_s: float | None = None) -> DriveReading:
        """Read statusword, position and load.

        Parameters
        ----------
        since_s : float or None
            Rig time just before a SYNC [s]: what the drive reports at it is read if it can, with the motor current.

        Raises
        ------
        DriveError
            When the drive cannot move: a fault, a restart, silence, or power off.
        """
        statusword, counter, current_ma, inputs = self.reports.read(since_s)
        self._was_enabled = decode_state(statusword) is DriveState.OPERATION_ENABLED
        self.check()
        if not self._was_enabled:
            self._require_enabled(statusword)
        arrived = self._target is None or (
            bool(statusword & TARGET_REACHED) and abs(counter - self._target) <= self._window_counts
        )
        return DriveReading(self._position(counter), statusword, arrived, current_ma, inputs)

    # Moving

    def round_move(self, position: float, speed: float) -> Setpoint:
        """Return the nearest move in whole counts and units of speed."""
        sent = self._counter(position), self.scale.to_speed_units(speed)
        return Setpoint(position, speed, self._position(sent[0]), self.scale.to_speed(sent[1]), *sent)

    def start_move(self, position: float, speed: float) -> None:
        """Start a move to an absolute position [mm or rad, per s], and return once the drive has accepted it.

        It replaces a move in progress.
        """
        self._target = self._counter(position)
        # The drive takes a set-point at the rising edge of its bit; an acknowledge of an earlier one would seem
        # to be its own.
        self._wait_until(lambda: not self._acknowledges(), "get ready for a set-point")
        self._set_mode(co.PROFILE_POSITION)
        self.adjust({co.PROFILE_VELOCITY: self.scale.to_speed_units(speed)})
        self.download(co.TARGET_POSITION, self._target)
        self.download(co.CONTROLWORD, ENABLE | NEW_SETPOINT | CHANGE_IMMEDIATELY)
        self._wait_until(self._acknowledges, "acknowledge the set-point")
        self.download(co.CONTROLWORD, ENABLE)
        self._wait_until(lambda: not self._acknowledges(), "take back the acknowledge of the set-point")

    def _acknowledges(self) -> bool:
        """Tell whether an enabled drive acknowledges a set-point."""
        statusword = self._statusword()
        self._require_enabled(statusword)
        return bool(statusword & SETPOINT_ACKNOWLEDGED)

    # Stopping

    def post_stop(self, *, quick: bool = False) -> None:
        """Send Halt to a drive that was last known enabled, or a quick stop to any, and wait for no answer.

        A node that somebody has stopped takes no request until it is started again. Raises `BusError`.
        """
        if quick or self._was_enabled:
            if self._nmt_state == NMT_STOPPED:
                self.send_nmt(NMT_START)
            data = self.variables[co.CONTROLWORD].encode_raw(QUICK_STOP if quick else ENABLE | HALT)
            self.sdo.post(co.CONTROLWORD, data)

    def stop(self, *, quick: bool = False) -> None:
        """Decelerate and hold, if power is on; a quick stop leaves operation enabled, and wakes a stopped node."""
        if quick:
            self._do_awake(lambda: self._go_to(TargetState.QUICK_STOPPED))
        elif decode_state(self._statusword()) is DriveState.OPERATION_ENABLED:
            self.download(co.CONTROLWORD, ENABLE | HALT)

    def _settle(self) -> None:
        """Return when the axis stands still. Raises `DriveError` if it still moves after `ANSWER_TIME_S`."""
        for _ in self.wait_until_still(ANSWER_TIME_S):
            self._clock.sleep(STILL_POLL_S)

    def wait_until_still(self, within_s: float) -> Iterator[None]:
        """Poll the position until all readings of `still_time_s` lie within the dither.

        Ends when the axis stands still; until then the caller lets `STILL_POLL_S` pass after each reading.
        """
        deadline_s = self._clock.now_s() + within_s
        readings = deque([self.upload(co.POSITION_ACTUAL)], maxlen=self._readings_until_still)
        while len(readings) < self._readings_until_still or max(readings) - min(readings) > STILL_COUNTS:
            if self._clock.now_s() > deadline_s:
                raise DriveError(
                    f"{self.name} still moves {within_s:.1f} s after it was stopped "
                    f"({readings[0]} -> {readings[-1]} counts)",
                    "press the emergency stop",
                )
            yield
            readings.append(self.upload(co.POSITION_ACTUAL))

    # Reference

    def home(self, homing: Homing) -> Iterator[None]:
        """Home, from standstill and enabled, and hold at home, ready for moves; the caller lets time pass at each turn.

        `homing.method` is a key of the section's `homing_directions`. This discards the position of `assume_position`.

        Raises
        ------
        DriveError
            When home is not found, or not in time; home found by an earlier homing does not count.
        """
        self._offset_counts, self._target, self._has_homed = 0, None, False
        due_s = self._clock.now_s() + homing.timeout_s
        settings = list_homing_settings(self.section, self.model, homing)
        self._set_mode(co.HOMING)
        self.adjust(settings)
        self.download(co.CONTROLWORD, ENABLE)
        # An attained bit from an earlier homing does not count until it has fallen.
        is_fresh = not self._statusword() & HOMING_ATTAINED or homing.method == HOMING_HERE
        self.download(co.CONTROLWORD, ENABLE | NEW_SETPOINT)
        while True:
            statusword = self._statusword()
            self._require_enabled(statusword)
            if statusword & HOMING_ERROR:
                raise DriveError(
                    f"{self.name} did not find home (statusword 0x{statusword:04X})",
                    "check switches, current threshold and direction of its homing",
                )
            is_fresh |= not statusword & HOMING_ATTAINED
            if is_fresh and statusword & HOMING_ATTAINED and statusword & TARGET_REACHED:
                break
            if self._clock.now_s() > due_s:
                raise DriveError(f"{self.name} did not find home in time", "see its homing section")
            yield
        self._settle()
        self._hold_at_home(homing)

    def _hold_at_home(self, homing: Homing) -> None:
        """Hold, after checking the counter: even a fresh bit can be wrong, and makers differ in the sign of a home."""
        counter, home = self.upload(co.POSITION_ACTUAL), self.scale.to_counts(homing.position)
        reads = f"{self.name} reads {counter} counts"
        if homing.method == HOMING_HERE and abs(counter - home) > STILL_COUNTS:
            raise DriveError(f"{reads} after homing here, expected {home}", CHECK_POWER)
        self.download(co.CONTROLWORD, ENABLE | HALT)
        self.download(co.TARGET_POSITION, counter)
        self._set_mode(co.PROFILE_POSITION)
        if abs(counter - home) > abs(counter + home):
            raise DriveError(
                f"{reads} at home, {home} was requested: it uses the opposite sign for the home position",
                "leave objects.home_position out, and write homing.position: 0",
            )
        self._has_homed = True

    def is_referenced(self) -> bool:
        """Tell whether the drive has its reference; a drive that cannot tell has it only until it is closed."""
        bit = self.model.referenced_bit
        if bit is None:
            return self._has_homed and not self.has_restarted
        return bool(self._statusword() >> bit & 1)

    def assume_position(self, position: float) -> None:
        """Assume that the axis is at this position [mm or rad]; the drive keeps its counter."""
        self._offset_counts = self.scale.to_counts(position) - self.upload(co.POSITION_ACTUAL)
        self._target = None

    def set_limits(self, limits: tuple[float, float] | None) -> None:
        """Set the limits of the drive, if it has any, wider by the window: a count beyond is a fault. None: none."""
        places = (co.LOWER_LIMIT, co.UPPER_LIMIT)
        if not all(map(self.model.has, places)):
            return
        if limits is None:
            self.adjust({place: find_default(self.variables[place]) for place in places})
            return
        low, high = sorted(map(self.scale.to_counts, limits))
        ends = (low - self._window_counts, high + self._window_counts)
        self.adjust(dict(zip(places, ends, strict=True)))

    # Faults

    def _require_enabled(self, statusword: int) -> None:
        """Refuse a statusword with which the drive cannot move, and what the drive has said. Raises `DriveError`."""
        self.check()
        state = decode_state(statusword)
        if state is DriveState.OPERATION_ENABLED:
            return
        self._refuse_fault(statusword)
        raise DriveError(
            f"{self.name} is in {state.name} (statusword 0x{statusword:04X}), expected OPERATION_ENABLED",
            "open the rig again once the cause is known",
        )

    def _refuse_fault(self, statusword: int) -> None:
        if decode_state(statusword) in FAULTED:
            raise self._make_fault(self._find_error_code(), self.upload(co.ERROR_REGISTER))

    def fault(self) -> DriveFaultError | None:
        """Return the newest fault, if the statusword shows one."""
        try:
            self._refuse_fault(self._statusword())
        except DriveFaultError as fault:
            return fault
        return None

    def reset_fault(self) -> None:
        """Reset a fault that a person has confirmed; power stays off and nothing moves.

        Raises
        ------
        DriveFaultError
            When the cause persists.
        """
        fault = self.fault()
        if fault is None:
            return
        if fault.code in self.model.reset_communication_first:
            self._reset_communication()
        self.download(co.CONTROLWORD, 0)
        self.download(co.CONTROLWORD, FAULT_RESET)
        self._clock.sleep(_RESET_TIME_S)
        self.download(co.CONTROLWORD, 0)
        self._emergency = None
        if fault := self.fault():
            raise fault.reword(f"{fault.message}; it could not be reset, its cause is still there")

    def _reset_communication(self) -> None:
        """Reset the communication, and restore what that clears: heartbeats and report, once configured."""
        self.send_nmt(NMT_RESET_COMMUNICATION)
        self._clock.sleep(ANSWER_TIME_S)
        self.has_restarted = False
        self.send_nmt(NMT_START)
        if self._heartbeat is not None:
            self._watch(self._heartbeat)
            self.adjust(self._consume(self._heartbeat))
            self.reports.switch_on()
