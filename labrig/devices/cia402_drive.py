"""What drives of the profile CiA 402 have in common on a CANopen bus; each kind adds its objects, errors and identity.

What is decided here
--------------------
- SDO through our own client; `canopen`'s `BaseNode402` is not used, because it resets faults, enables
  power and reads signs of homing methods by itself, wrongly for maxon.
- While axes move, statusword and position come at each SYNC in one process-data frame a drive instead of four; a
  report that does not come is asked for by SDO, and counted. Its map is not written: where it is not the
  one that is looked for, or the drive refuses to switch the report on, SDO does it all.
- Nothing is believed that has not been read back: each setting after writing, the set-point acknowledge with
  both edges, the position at the end of a move, standing still after a stop.
- Power is never switched on but by `enable`, which holds Halt and has the actual position as target, so that
  nothing moves until a move is commanded. A fault is reset by `reset_fault` alone, once a person has confirmed.
- Only settings that differ are written.
- A drive is watched: its heartbeat, its EMCY and its boot-up become errors as soon as the rig looks.
- A question without an answer is asked once more, and that is counted.
- Unsure until tried on a device: that bit 12 falls when a homing starts, which a fresh attained bit needs (where
  it does not, homing ends in its timeout with the axis halted); that two nodes of one id both answer (on a wire
  they may as well destroy each other's frames, and are silent then).
"""

import math
import struct
from collections import deque
from collections.abc import Iterable, Iterator, Mapping
from functools import cached_property
from queue import SimpleQueue
from typing import ClassVar, Generic, TypeVar

from labrig.clock import Clock
from labrig.devices import canopen_objects as co
from labrig.devices.axis_description import AxisDescription
from labrig.devices.bus import CanLink
from labrig.devices.can_description import HeartbeatDescription
from labrig.devices.canopen_objects import Entry
from labrig.devices.cia402_states import (
    CHANGE_IMMEDIATELY,
    ENABLE,
    FAULT_RESET,
    FAULTED,
    HALT,
    HOMING_ATTAINED,
    HOMING_ERROR,
    NEW_SETPOINT,
    REFERENCED,
    SETPOINT_ACKNOWLEDGED,
    TARGET_REACHED,
    DriveState,
    TargetState,
    decode_standard_state,
    plan_controlword,
)
from labrig.devices.drive import STILL_LOOK_S, DriveReading, Homing, RoundedMove
from labrig.devices.error_codes import Emergency, describe_abort
from labrig.devices.homing import HOMING_HERE
from labrig.devices.sdo_client import RETRIES, SdoAbortedError, SdoClient, SdoSilenceError
from labrig.devices.units import AxisScale
from labrig.errors import (
    HEARTBEAT_LOST,
    DriveError,
    DriveFaultError,
    DriveRefusedError,
    DriveRestartedError,
    DriveSilentError,
)

POLL_S = 0.005
ANSWER_TIME_S = 1.0
"""Rig time within which a drive attains a state, acknowledges a set-point or finishes homing on the spot."""

STILL_COUNTS = 2
"""A servo at rest dithers by so much [counts]."""

LONGEST_STILL_TIME_S = 0.4
"""For so long a position must stay within the dither where nobody knows how fast the slowest creep counts [s]."""

_CLASHING_ANSWERS = 3
"""Answers that nobody asked for among those to who a drive is: one may be a frame that came twice."""

_RESET_TIME_S = 0.05
"""How long a drive is given to take the reset of a fault."""

_PROFILE_POSITION, _HOMING = 1, 6
_NMT_START, _NMT_PRE_OPERATIONAL, _NMT_RESET_COMMUNICATION = 0x01, 0x80, 0x82

_PDO_UNUSED = 0x80000000
_CHECK_POWER = "check power, CAN wiring, bit rate and node id of the drive"
_EMERGENCY = struct.Struct("<HB")

_REPORT_MAP = (2, co.STATUSWORD.index << 16 | 16, co.POSITION_ACTUAL.index << 16 | 32)
_REPORT, _NO_REMOTE, _AT_EACH_SYNC = struct.Struct("<Hi"), 0x40000000, 1
_REPORT_PATIENCE = 0.25
"""Part of the time for an answer that a report may take: it is a frame that is already on its way."""

Section = TypeVar("Section", bound=AxisDescription)


def still_time_s(slowest_counts_per_s: float | None) -> float:
    """Return for how long a position must stay within `STILL_COUNTS` before an axis is said to stand still [s].

    In this time the slowest speed that the drive can be told counts more than the dither at either end of the time:
    such a creep never counts as standing still. Where that takes longer than `LONGEST_STILL_TIME_S`, or the speed is
    unknown (None), it is that time, and a slower creep is not seen.
    """
    if slowest_counts_per_s is None:
        return LONGEST_STILL_TIME_S
    return min((2 * STILL_COUNTS + 1) / slowest_counts_per_s, LONGEST_STILL_TIME_S)


class Cia402Drive(Generic[Section]):
    """A drive; a kind derives from it and adds `identify`, settings, homing and errors.

    Parameters
    ----------
    link : CanLink
        The bus.
    section : AxisDescription
        Section of its axis in the rig file; may be incomplete.
    axis : str
        The axis that it drives, for messages.
    clock : Clock
        Whose time bounds waiting.
    node_id : int
        Its node id.
    still_time_s : float
        For how long a position must stay within `STILL_COUNTS` before the axis is said to stand still [s].

    Attributes
    ----------
    tool : str
        The manufacturer's program, for hints.
    reset_communication_first : frozenset of int
        Faults whose reset the drive takes only after its communication has been reset.
    report_pdo : int
        Transmit PDO, counted from 0, in which statusword and position are looked for.
    """

    tool: ClassVar[str] = "the program of its manufacturer"
    reset_communication_first: ClassVar[frozenset[int]] = frozenset({0x8120, 0x8130, 0x8140, 0x81FD})
    report_pdo: ClassVar[int] = 2

    def __init__(
        self,
        link: CanLink,
        section: Section,
        axis: str,
        clock: Clock,
        *,
        node_id: int,
        still_time_s: float = LONGEST_STILL_TIME_S,
    ) -> None:
        self.name = f"drive of axis {axis} (node {node_id})"
        self.node_id = node_id
        self.section = section
        self._clock = clock
        self._link = link
        self.sdo = SdoClient(link, node_id)
        self._looks_until_still = 1 + math.ceil(still_time_s / STILL_LOOK_S)
        self._offset_counts = 0
        self._target: int | None = None
        self._settings: dict[Entry, int] = {}
        self._heartbeat: HeartbeatDescription | None = None
        self._own_limits: dict[Entry, int] = {}
        self._written: tuple[str, ...] = ()
        self.has_restarted = False
        self._emergency: tuple[int, int] | None = None
        self._heard_s = 0.0
        self._silence_s = math.inf
        self._attained_is_fresh = False
        self._was_enabled = False
        self._homing_due_s = math.inf
        self._reports: SimpleQueue[bytes] = SimpleQueue()
        self._has_reports = self._awaits_report = False
        self._missed_reports = self._stray_reports = 0
        self._report_id = 0x180 + 0x100 * self.report_pdo + node_id
        link.network.subscribe(self._report_id, lambda _id, data, _t: self._reports.put(bytes(data)))
        link.network.subscribe(0x700 + node_id, self._on_heartbeat)
        link.network.subscribe(0x080 + node_id, self._on_emergency)

    # Units

    @cached_property
    def scale(self) -> AxisScale:
        """The conversion to counts and speeds of the drive. Raises `InputError` where an entry is unknown."""
        return self.section.scale()

    def _counter(self, position: float) -> int:
        """Return what the drive's counter reads at a position."""
        return self.scale.to_counts(position) - self._offset_counts

    def _position(self, counter: int) -> float:
        """Return the position at which the drive's counter reads this."""
        return self.scale.to_position(counter + self._offset_counts)

    @property
    def _window_counts(self) -> int:
        return self.scale.to_distance_counts(self.section.position_window)

    # What a kind of drive has of its own

    def decode(self, statusword: int) -> DriveState:
        """Return the state that a statusword tells, as CiA 402 has it."""
        return decode_standard_state(statusword)

    def own_entry(self, entry: Entry) -> Entry:
        """Return an object with the width that it has in this drive."""
        return entry

    def has(self, entry: Entry) -> bool:  # noqa: ARG002 - for drives that lack some
        """Tell whether the drive has an object that not every drive has."""
        return True

    # Objects

    def upload(self, entry: Entry) -> int:
        """Return the value of an object.

        Raises
        ------
        DriveSilentError, DriveRefusedError, BusError
        """
        entry = self.own_entry(entry)
        try:
            return entry.unpack(self.sdo.upload(entry.index, entry.subindex))
        except SdoAbortedError as error:
            raise self._refused(entry.name, error) from error
        except SdoSilenceError as error:
            raise self._silent(entry.name) from error

    def download(self, entry: Entry, value: int) -> None:
        """Write an object. Raises as `upload`."""
        entry = self.own_entry(entry)
        what = f"{entry.name} ({entry.place}) = {value}"
        try:
            self.sdo.download(entry.index, entry.subindex, entry.pack(value))
        except SdoAbortedError as error:
            raise self._refused(what, error) from error
        except SdoSilenceError as error:
            raise self._silent(what) from error

    def _refused(self, what: str, error: SdoAbortedError) -> DriveRefusedError:
        text = describe_abort(error.code)
        return DriveRefusedError(
            f"{self.name} refused {what}: {text} (SDO abort 0x{error.code:08X})",
            "check rig file and drive settings against each other",
            code=error.code,
            text=text,
        )

    def _silent(self, what: str) -> DriveSilentError:
        return DriveSilentError(
            f"{self.name} did not answer within {self._link.answer_timeout_s:g} s, asked {1 + RETRIES} times "
            f"({what})",
            _CHECK_POWER,
        )

    def counts(self) -> dict[str, int]:
        """Return how often it had to be asked again, and how many of its answers nobody had asked for."""
        return {
            "retries": self.sdo.retries + self._missed_reports,
            "strays": self.sdo.strays + self._stray_reports,
        }

    # Connecting

    def wake(self) -> int:
        """Return the vendor id; a node that `labrig devices stop` has stopped answers nothing until it is woken."""
        try:
            return self.upload(co.VENDOR_ID)
        except DriveSilentError:
            self.send_nmt(_NMT_PRE_OPERATIONAL)
            return self.upload(co.VENDOR_ID)

    def require_alone(self, strays: int) -> None:
        """Refuse a node id for which two nodes have answered, since there were so many stray answers.

        Answers to whoever asked before do not count. Raises `DriveError`.
        """
        if self.sdo.strays - strays >= _CLASHING_ANSWERS:
            raise DriveError(
                f"{self.name}: two nodes answer as node {self.node_id}",
                "give every drive a node id of its own",
            )

    def cob_ids(self) -> tuple[frozenset[int], frozenset[int]]:
        """Return the COB-IDs of process data that the drive sends, and that it obeys."""
        return self._cob_ids(co.TRANSMIT_PDO_COB_IDS), self._cob_ids(co.RECEIVE_PDO_COB_IDS)

    def _cob_ids(self, entries: Iterable[Entry]) -> frozenset[int]:
        values = (self.upload(entry) for entry in entries if self.has(entry))
        return frozenset(value & 0x7FF for value in values if not value & _PDO_UNUSED)

    def configure(self, heartbeat: HeartbeatDescription, max_current_ma: int | None) -> None:
        """Hold the drive off and give it its settings; heartbeats are watched from here."""
        self.hold_off()
        self._heartbeat = heartbeat
        self.watch(heartbeat.period_ms, heartbeat.timeout_ms / 1000)
        limit = self.limit_current(max_current_ma)
        self._settings = self.settings_of(heartbeat) | limit
        self._written = self.write_settings(self._settings)
        self.let_report()

    def settings_of(self, heartbeat: HeartbeatDescription) -> dict[Entry, int]:
        """Return what the drive must be set to for its section, the dead-man too."""
        raise NotImplementedError

    def limit_current(self, max_current_ma: int | None) -> dict[Entry, int]:
        """Return the setting that limits the current, and keep the drive's own for `close`.

        Raises
        ------
        DriveError
            Where the drive has no limit.
        """
        if max_current_ma is None:
            return {}
        found = self.find_current_limit()
        if found is None:
            raise DriveError(
                f"{self.name} has no current limit that labrig can set, asked for {max_current_ma} mA",
                f"set it in {self.tool}; --current-ma 0 asks for none",
            )
        entry, milliamperes = found
        own = self.upload(entry)
        self._own_limits = {entry: own}
        return {entry: min(math.floor(max_current_ma / milliamperes), own)}

    def find_current_limit(self) -> tuple[Entry, float] | None:
        """Return the object that limits the current and what one unit of it is [mA]; None where there is none."""
        return None

    def settings(self) -> dict[str, int]:
        """Return what each setting was asked to be; each was read back, those that differed were written."""
        return {entry.place: value for entry, value in self._settings.items()}

    def describe(self) -> dict[str, object]:
        """Return how the drive is set, for the record."""
        return {
            "drive_settings": self.settings(),
            "settings_written": list(self._written),
            **self.counts(),
        }

    def close(self) -> None:
        """Switch power off, give the drive its current limit back, and let both heartbeats end, which is no fault."""
        self.disable()
        if self._own_limits:
            self.adjust(self._own_limits)
        self.unwatch()

    def hold_off(self) -> None:
        """Start the node, stop what moves, and switch the power stage off.

        Raises
        ------
        DriveError
            Also when it reports a fault.
        """
        self.send_nmt(_NMT_START)
        self.raise_if_faulted()
        self.stop()
        self.settle(ANSWER_TIME_S)
        self.go_to(TargetState.POWER_OFF)

    def write_settings(self, settings: Mapping[Entry, int]) -> tuple[str, ...]:
        """Bring settings to what they must be, each read back; return the places of those that were written.

        Raises
        ------
        DriveError
        """
        return tuple(entry.place for entry, value in settings.items() if self.ensure(entry, value))

    def adjust(self, settings: Mapping[Entry, int]) -> bool:
        """Bring settings to what operation asks for; return whether any was written. Raises `DriveError`."""
        return bool(self.write_settings(settings))

    def ensure(self, entry: Entry, value: int) -> bool:
        """Write an object where it differs, and read it back; return whether it was written."""
        if self.upload(entry) == value:
            return False
        self.download(entry, value)
        found = self.upload(entry)
        if found != value:
            raise DriveError(
                f"{self.name} kept {entry.name} ({entry.place}) at {found} when {value} was written",
                f"check whether the drive's parameters are locked in {self.tool}",
            )
        return True

    def send_nmt(self, command: int) -> None:
        """Send an NMT command to this node; NMT is not answered."""
        self._link.send(0x000, bytes([command, self.node_id]))

    # Heartbeats

    def verify_dead_man(self, heartbeat: HeartbeatDescription) -> None:
        """Let the drive stop by itself when the computer falls silent, and read that back."""
        self.adjust({co.CONSUMER_HEARTBEAT: heartbeat.computer_node_id << 16 | heartbeat.timeout_ms})

    def watch(self, period_ms: int, silence_s: float) -> None:
        """Let the drive beat, and count it as silent when no beat is heard for `silence_s`."""
        self.adjust({co.PRODUCER_HEARTBEAT: period_ms})
        self._heard_s = self._clock.now_s()
        self._silence_s = silence_s

    def unwatch(self) -> None:
        """Let both heartbeats end: the drive is left alone without power, which is no fault."""
        self._silence_s = math.inf
        self.adjust({co.CONSUMER_HEARTBEAT: 0, co.PRODUCER_HEARTBEAT: 0})

    # States

    def go_to(self, goal: TargetState) -> None:
        """Bring the drive to a goal of its state machine.

        Raises
        ------
        DriveError
            On a fault when it is to be enabled, or when it has been in a state for too long, also on and off.
        """
        since_s: dict[DriveState, float] = {}
        while True:
            statusword = self.statusword()
            state, now_s = self.decode(statusword), self._clock.now_s()
            if goal is TargetState.ENABLED:
                self._refuse_fault(statusword)
            plan = plan_controlword(statusword, goal, self.decode)
            if plan.attained:
                return
            if now_s - since_s.setdefault(state, now_s) > ANSWER_TIME_S:
                raise DriveError(
                    f"{self.name} stayed in {state.name} for {ANSWER_TIME_S:g} s "
                    f"on the way to {goal.name} (statusword 0x{statusword:04X})",
                    f"look at its status in {self.tool}",
                )
            if plan.controlword is not None:
                self.download(co.CONTROLWORD, plan.controlword)
            self._clock.sleep(POLL_S)

    def enable(self) -> None:
        """Switch the power stage on; the axis holds where it is."""
        self.ensure(co.MODE, _PROFILE_POSITION)
        self.download(co.CONTROLWORD, HALT)
        self.download(co.TARGET_POSITION, self.upload(co.POSITION_ACTUAL))
        self.go_to(TargetState.ENABLED)

    def disable(self) -> None:
        """Switch the power stage off."""
        self.go_to(TargetState.POWER_OFF)

    def counter(self) -> int:
        """Return the actual position [counts]."""
        return self.upload(co.POSITION_ACTUAL)

    def position(self) -> float:
        """Return where the axis stands [mm or rad]."""
        return self._position(self.counter())

    def statusword(self) -> int:
        """Return the statusword."""
        statusword = self.upload(co.STATUSWORD)
        self._note_state(statusword)
        return statusword

    def let_report(self) -> None:
        """Let the drive report at each SYNC, where a PDO of it carries statusword and position and may be switched on.

        Raises
        ------
        DriveError, BusError
        """
        mapping = co.TPDO_MAPS[self.report_pdo][: len(_REPORT_MAP)]
        found = tuple(self.upload(entry) for entry in mapping if self.has(entry))
        self._has_reports = found == _REPORT_MAP
        if not self._has_reports:
            return
        cob_id = _NO_REMOTE | self._report_id
        try:
            self.adjust(
                {
                    co.TPDO_TYPES[self.report_pdo]: _AT_EACH_SYNC,
                    co.TRANSMIT_PDO_COB_IDS[self.report_pdo]: cob_id,
                }
            )
        except DriveRefusedError:
            self._has_reports = False

    def expect_report(self) -> None:
        """Forget what has been reported: the next `report` is of the SYNC that is about to be sent."""
        self._awaits_report = self._has_reports
        while not self._reports.empty():
            self._reports.get_nowait()
            self._stray_reports += 1

    def report(self) -> tuple[int, int]:
        """Return statusword and position [counts]: as reported, or asked for when no report is expected or comes.

        Raises
        ------
        DriveError, BusError
        """
        awaited, self._awaits_report = self._awaits_report, False
        if awaited:
            patience_s = _REPORT_PATIENCE * self._link.answer_timeout_s
            data = self._link.receive(self._reports, self._link.clock.now_s() + patience_s)
            if data is not None and len(data) == _REPORT.size:
                statusword, position = _REPORT.unpack(data)
                self._note_state(statusword)
                return statusword, position
            self._missed_reports += 1
        return self.statusword(), self.counter()

    def _note_state(self, statusword: int) -> None:
        self._was_enabled = self.decode(statusword) is DriveState.OPERATION_ENABLED

    # Moving

    def round_move(self, position: float, speed: float) -> RoundedMove:
        """Return the move in whole counts and units of speed that is nearest to this one."""
        counter, units = self._counter(position), self.scale.to_speed_units(speed)
        return RoundedMove(
            self._position(counter), self.scale.to_speed(units), self.name_sent(counter, units)
        )

    def name_sent(self, counter: int, speed_units: int) -> dict[str, int]:
        """Return what goes over the wire, by the names that the record gives it."""
        return {"sent_counts": counter, "sent_speed_units": speed_units}

    def start_move(self, position: float, speed: float) -> None:
        """Start a move to an absolute position [mm or rad, per s]."""
        self._target = self._counter(position)
        self.start_profile(self._target, self.scale.to_speed_units(speed))

    def read(self) -> DriveReading:
        """Read statusword and position. Raises `DriveError` where the drive cannot move."""
        statusword, counter = self.report()
        self.refuse_unless_enabled(statusword)
        arrived = self._target is None or (
            bool(statusword & TARGET_REACHED) and abs(counter - self._target) <= self._window_counts
        )
        return DriveReading(self._position(counter), statusword, self.decode(statusword), arrived)

    def start_profile(self, target: int, speed_units: int) -> None:
        """Start a profile to an absolute position, with both edges of the set-point handshake.

        Parameters
        ----------
        target : int
            Where to [counts].
        speed_units : int
            Speed of the motor, as the drive takes it.

        Raises
        ------
        DriveError
        """
        # A set-point is taken at the rising edge of its bit; an acknowledge left from another would look like
        # success.
        self._wait_for_bit(SETPOINT_ACKNOWLEDGED, 0, "get ready for a set-point")
        self._refuse_unless_enabled(self.statusword())
        self.ensure(co.MODE, _PROFILE_POSITION)
        self.adjust({co.PROFILE_VELOCITY: speed_units})
        self.download(co.TARGET_POSITION, target)
        self.download(co.CONTROLWORD, ENABLE | NEW_SETPOINT | CHANGE_IMMEDIATELY)
        self._wait_for_bit(SETPOINT_ACKNOWLEDGED, SETPOINT_ACKNOWLEDGED, "acknowledge the set-point")
        self.download(co.CONTROLWORD, ENABLE)
        self._wait_for_bit(SETPOINT_ACKNOWLEDGED, 0, "take back the acknowledge of the set-point")

    # Stopping

    def stop(self) -> None:
        """Decelerate and hold, if the axis is powered; power is never switched on by this."""
        if self.decode(self.statusword()) is DriveState.OPERATION_ENABLED:
            self.download(co.CONTROLWORD, ENABLE | HALT)

    def send_stop(self) -> None:
        """Tell a drive that was enabled when it was last heard to halt, and wait for nothing. Raises `BusError`."""
        if self._was_enabled:
            data = self.own_entry(co.CONTROLWORD).pack(ENABLE | HALT)
            self.sdo.post(co.CONTROLWORD.index, co.CONTROLWORD.subindex, data)

    def quick_stop(self) -> None:
        """Stop with the quick stop deceleration and leave operation enabled."""
        self.go_to(TargetState.QUICK_STOPPED)

    def settle(self, within_s: float) -> None:
        """Return once the axis stands still. Raises `DriveError` when it still moves after `within_s`."""
        for _ in self.wait_until_still(within_s):
            self._clock.sleep(STILL_LOOK_S)

    def wait_until_still(self, within_s: float) -> Iterator[None]:
        """Look at the position until all that were read in `still_time_s` lie within its dither.

        Ends once it stands still; until then the caller lets `STILL_LOOK_S` pass after each look.

        Raises
        ------
        DriveError
            When it still moves after `within_s`.
        """
        deadline_s = self._clock.now_s() + within_s
        seen = deque([self.counter()], maxlen=self._looks_until_still)
        while len(seen) < self._looks_until_still or max(seen) - min(seen) > STILL_COUNTS:
            if self._clock.now_s() > deadline_s:
                raise DriveError(
                    f"{self.name} still moves {within_s:.1f} s after it was stopped "
                    f"({seen[0]} -> {seen[-1]} {self.section.count_unit})",
                    "press the emergency stop",
                )
            yield
            seen.append(self.counter())

    # Reference

    def homing_settings(self, homing: Homing) -> Iterator[tuple[Entry, int]]:
        """Yield what a homing needs written, mode and method left out; each kind has its own objects."""
        raise NotImplementedError

    def home_counter(self, homing: Homing) -> int:
        """Return what the counter reads where home has been found."""
        return self.scale.to_counts(homing.position)

    def start_homing(self, homing: Homing) -> None:
        """Begin to look for home; `has_homed` says when it is found, `finish_homing` is due then."""
        self._offset_counts, self._target = 0, None
        self._homing_due_s = self._clock.now_s() + homing.timeout_s
        method = {co.MODE: _HOMING, co.HOMING_METHOD: self.homing_method(homing.method)}
        self.adjust(method | dict(self.homing_settings(homing)))
        self.download(co.CONTROLWORD, ENABLE)
        # An attained bit left from an earlier homing is not believed until it has been seen to fall.
        self._attained_is_fresh = not self.statusword() & HOMING_ATTAINED or homing.method == HOMING_HERE
        self.download(co.CONTROLWORD, ENABLE | NEW_SETPOINT)

    def homing_method(self, method: int) -> int:
        """Return the number under which the drive has a homing method."""
        return method

    def has_homed(self) -> bool:
        """Tell whether home has been found since `start_homing`.

        Raises
        ------
        DriveError
            When the drive says that it cannot be found, is in fault, or takes longer than the homing may.
        """
        statusword = self.statusword()
        self.refuse_unless_enabled(statusword)
        if statusword & HOMING_ERROR:
            raise DriveError(
                f"{self.name} did not find home (statusword 0x{statusword:04X})",
                "check switches, current threshold and direction of its homing",
            )
        attained = bool(statusword & HOMING_ATTAINED)
        self._attained_is_fresh |= not attained
        if attained and self._attained_is_fresh and statusword & TARGET_REACHED:
            return True
        if self._clock.now_s() > self._homing_due_s:
            raise DriveError(f"{self.name} did not find home in time", "see its homing section")
        return False

    def finish_homing(self, homing: Homing) -> None:
        """Check that the counter is where homing leaves it, and hold there in profile position mode."""
        self.settle(ANSWER_TIME_S)
        # Even a fresh bit can be wrong; that the counter has been set cannot be.
        counter, home = self.counter(), self.home_counter(homing)
        if homing.method == HOMING_HERE and abs(counter - home) > STILL_COUNTS:
            raise DriveError(
                f"{self.name} reads {counter} {self.section.count_unit} after homing here, expected {home}",
                _CHECK_POWER,
            )
        self.download(co.CONTROLWORD, ENABLE | HALT)
        self.download(co.TARGET_POSITION, counter)
        self.ensure(co.MODE, _PROFILE_POSITION)

    def is_referenced(self) -> bool:
        """Tell whether the drive itself knows its position to be referenced; lost with its power."""
        return bool(self.statusword() & REFERENCED)

    def assume_position(self, position: float) -> None:
        """Take the axis to stand at this position [mm or rad]; the drive keeps its counter."""
        self._offset_counts = self.scale.to_counts(position) - self.counter()
        self._target = None

    def set_limits(self, limits: tuple[float, float] | None) -> None:
        """Give the drive limits, wider by the window: one count beyond is a fault to it. None takes them off."""
        if limits is None:
            self.adjust({entry: entry.default for entry in (co.LOWER_LIMIT, co.UPPER_LIMIT)})
            return
        low, high = sorted(map(self.scale.to_counts, limits))
        window = self._window_counts
        self.write_settings({co.LOWER_LIMIT: low - window, co.UPPER_LIMIT: high + window})

    # Faults

    def raise_if_faulted(self) -> None:
        """Raise what the drive reported by itself, or what its statusword says.

        Raises
        ------
        DriveError
            Names the error code, what it means and what to do.
        """
        self.check()
        self._refuse_fault(self.statusword())

    def check(self) -> None:
        """Raise a restart, an emergency or a silence that has been noticed; asks the drive nothing.

        Raises
        ------
        DriveRestartedError, DriveFaultError, DriveSilentError
        """
        if self.has_restarted:
            raise DriveRestartedError(
                f"{self.name} has restarted: it lost power, its position and its reference",
                "find out why it lost power; do not home while a needle is in tissue",
            )
        if self._emergency is not None:
            raise self._fault(*self._emergency)
        silent_s = self._clock.now_s() - self._heard_s
        if silent_s > self._silence_s:
            raise DriveSilentError(
                f"{self.name} has sent no heartbeat for {silent_s:.2f} s, expected one every "
                f"{self._silence_s:g} s at the latest",
                _CHECK_POWER,
                fault=HEARTBEAT_LOST,
            )

    def refuse_unless_enabled(self, statusword: int) -> None:
        """Raise when a statusword of this drive says that it cannot move. Raises `DriveError`."""
        self.check()
        self._refuse_unless_enabled(statusword)

    def _refuse_unless_enabled(self, statusword: int) -> None:
        self._refuse_fault(statusword)
        state = self.decode(statusword)
        if state is not DriveState.OPERATION_ENABLED:
            raise DriveError(
                f"{self.name} is in {state.name} (statusword 0x{statusword:04X}), expected OPERATION_ENABLED",
                "open the rig again once the cause is known",
            )

    def _refuse_fault(self, statusword: int) -> None:
        if self.decode(statusword) in FAULTED:
            raise self._fault(self.error_code(), self.upload(co.ERROR_REGISTER))

    def error_code(self) -> int:
        """Return the code of the newest error, as far as the drive tells it; 0 where it does not."""
        return self.upload(co.LAST_ERROR) & 0xFFFF if self.upload(co.ERROR_COUNT) else 0

    def describe_emergency(self, code: int) -> Emergency:
        """Return what an error code means; each kind has its own table."""
        return Emergency(code, 0x01, "unknown to labrig", "look it up in the manual of the drive")

    def _fault(self, code: int, register: int) -> DriveFaultError:
        emergency = self.describe_emergency(code)
        return DriveFaultError(
            f"{self.name} is in fault: {emergency} (error register 0x{register:02X})",
            emergency.remedy,
            code=code,
            register=register,
            text=emergency.text,
        )

    def current_ma(self) -> float | None:
        """Return nothing: the profile has no current in milliamperes."""
        return None

    def current_limit_ma(self) -> int | None:
        """Return the output current that the drive does not exceed [mA]; None where it has no such limit."""
        found = self.find_current_limit()
        return None if found is None else math.floor(self.upload(found[0]) * found[1])

    def faults(self) -> tuple[DriveFaultError, ...]:
        """Return the newest fault, where the drive is in one as its statusword says."""
        try:
            self._refuse_fault(self.upload(co.STATUSWORD))
        except DriveFaultError as fault:
            return (fault,)
        return ()

    def reset_fault(self) -> None:
        """Reset a fault, as a person has confirmed; power stays off and nothing moves.

        Raises
        ------
        DriveFaultError
            When the cause is still there.
        """
        faults = self.faults()
        if not faults:
            return
        if faults[0].code in self.reset_communication_first:
            self.send_nmt(_NMT_RESET_COMMUNICATION)
            self._clock.sleep(ANSWER_TIME_S)
            self.has_restarted = False
            self.send_nmt(_NMT_START)
            self._restore_communication()
        self.download(co.CONTROLWORD, 0)
        self.download(co.CONTROLWORD, FAULT_RESET)
        self._clock.sleep(_RESET_TIME_S)
        self.download(co.CONTROLWORD, 0)
        self._emergency = None
        for left in self.faults():
            raise left.reword(f"{left.message}; it could not be reset, its cause is still there")

    def _restore_communication(self) -> None:
        """Bring back what resetting the communication took: both heartbeats and the report, once configured."""
        if self._heartbeat is not None:
            self.watch(self._heartbeat.period_ms, self._heartbeat.timeout_ms / 1000)
            self.verify_dead_man(self._heartbeat)
            self.let_report()

    def _on_heartbeat(self, _can_id: int, data: bytearray, _timestamp: float) -> None:
        self._heard_s = self._clock.now_s()
        if data[:1] == b"\0":
            self.has_restarted = True

    def _on_emergency(self, _can_id: int, data: bytearray, _timestamp: float) -> None:
        if len(data) >= _EMERGENCY.size:
            code, register = _EMERGENCY.unpack_from(data)
            self._emergency = (code, register) if code else None

    def _wait_for_bit(self, mask: int, wanted: int, what: str) -> None:
        deadline_s = self._clock.now_s() + ANSWER_TIME_S
        while True:
            statusword = self.statusword()
            if statusword & mask == wanted:
                return
            self.refuse_unless_enabled(statusword)
            if self._clock.now_s() > deadline_s:
                raise DriveError(
                    f"{self.name} did not {what} within {ANSWER_TIME_S:g} s (statusword 0x{statusword:04X})",
                    f"look at its status in {self.tool}",
                )
            self._clock.sleep(POLL_S)
