"""The common part of CiA 402 drivers on a CANopen bus; each kind of drive adds its objects, errors and identity.

What is decided here
--------------------
- SDO goes through our own client. `canopen`'s `BaseNode402` is not used: it resets faults and enables power by itself,
  and its signs of homing methods are wrong for maxon.
- While axes move, each drive sends statusword, position and motor current at each SYNC in one process-data frame of 8
  bytes, instead of six SDO frames; inputs that the rig file names, and what does not fit, go into a second frame. A
  missing report is requested by SDO and counted. Current and inputs are mapped while the node is pre-operational and
  without power, behind statusword and position, which stand there by default. If the mapping is another one, or the
  drive refuses it, SDO does all of it. The mapping is not stored: it ends with the drive's power.
- Nothing counts until it has been read back: each setting after writing, both edges of the set-point acknowledge, the
  position at the end of a move, standstill after a stop.
- Only `enable` switches power on. It sets Halt and takes the actual position as target, so nothing moves until a move
  is commanded. Only `reset_fault` resets a fault, after a person has confirmed.
- Only settings that differ are written.
- A lost heartbeat, an EMCY and a boot-up of the drive become errors at the next call of `check` or `read`.
- A request without an answer is sent once more, and counted.
- Uncertain until tried on a device: whether bit 12 falls when homing starts, as a fresh attained bit requires (if not,
  homing ends in its timeout with the axis halted); whether two nodes with one id both answer (on a wire they may
  destroy each other's frames and seem silent).
"""

import math
import struct
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import cached_property
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
    QUICK_STOP,
    REFERENCED,
    SETPOINT_ACKNOWLEDGED,
    TARGET_REACHED,
    DriveState,
    TargetState,
    decode_standard_state,
    plan_controlword,
)
from labrig.devices.drive import STILL_COUNTS, STILL_POLL_S, DriveReading, Homing, RoundedMove
from labrig.devices.drive_reports import DriveReports, InputPlace, mapping_of, pack_into_pdos
from labrig.devices.error_codes import Emergency, describe_abort
from labrig.devices.homing import HOMING_HERE
from labrig.devices.input_channel import InputValue
from labrig.devices.sdo_client import NO_OBJECT, RETRIES, SdoAbortedError, SdoClient, SdoSilenceError
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
"""Longest rig time to reach a state, acknowledge a set-point or finish homing at the present position."""

LONGEST_STILL_TIME_S = 0.4
"""Time for which a position must stay within the dither if the speed of the slowest creep is unknown [s]."""

_CLASHING_ANSWERS = 3
"""Unexpected answers while a drive is identified that show two nodes; a single one may be a repeated frame."""

_RESET_TIME_S = 0.05
"""Time that a drive gets to reset a fault."""

_PROFILE_POSITION, _HOMING = 1, 6
_NMT_START, _NMT_STOP, _NMT_PRE_OPERATIONAL, _NMT_RESET_COMMUNICATION = 0x01, 0x02, 0x80, 0x82
_NMT_STOPPED, _NMT_OPERATIONAL = 0x04, 0x05
_NO_ACTION = 0
"""Value of 0x6007 with which a drive moves on when the computer falls silent."""

STOP_OPTIONS = {
    co.ABORT_CONNECTION: 1,  # a fault
    co.SHUTDOWN_OPTION: 1,  # brake, then switch power off
    co.DISABLE_OPTION: 1,  # brake, then switch power off
    co.FAULT_REACTION: 2,  # brake with the quick stop deceleration
}
"""Option codes with which a drive brakes wherever the profile lets it choose."""

_CHECK_POWER = "check power, CAN wiring, bit rate and node id of the drive"
_EMERGENCY = struct.Struct("<HB")

_REPORTED = (co.STATUSWORD, co.POSITION_ACTUAL)
_NO_REMOTE, _AT_EACH_SYNC = 0x40000000, 1
_REPORT_PATIENCE = 0.25
"""Longest wait for a report, as a part of the answer timeout: its frame is already on its way."""

Section = TypeVar("Section", bound=AxisDescription)
_T = TypeVar("_T")


def still_time_s(slowest_counts_per_s: float | None) -> float:
    """Return the time for which a position must stay within `STILL_COUNTS` before an axis counts as still [s].

    In this time the slowest commandable speed moves the counter by more than the dither at both ends, so a creep never
    counts as standstill. The time is at most `LONGEST_STILL_TIME_S`, also if the speed is unknown (None); a slower
    creep is not noticed.
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
        Name of its axis, for messages.
    clock : Clock
        Time for timeouts.
    node_id : int
        Its node id.
    still_time_s : float
        Time for which a position must stay within `STILL_COUNTS` before the axis counts as still [s].

    Attributes
    ----------
    tool : str
        The manufacturer's program, for hints.
    reset_communication_first : frozenset of int
        Faults that the drive resets only after its communication has been reset.
    report_pdo : int
        Transmit PDO, counted from 0, that is expected to hold statusword and position.
    load_pdo : int
        Transmit PDO for current and inputs without room there.
    """

    tool: ClassVar[str] = "the program of its manufacturer"
    reset_communication_first: ClassVar[frozenset[int]] = frozenset({0x8120, 0x8130, 0x8140, 0x81FD})
    report_pdo: ClassVar[int] = 2
    load_pdo: ClassVar[int] = 3

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
        self.axis = axis
        self.node_id = node_id
        self.section = section
        self._clock = clock
        self._link = link
        self.sdo = SdoClient(link, node_id)
        self._readings_until_still = 1 + math.ceil(still_time_s / STILL_POLL_S)
        self._offset_counts = 0
        self._target: int | None = None
        self._settings: dict[Entry, int] = {}
        self._dead_man: dict[str, int | None] = {}
        self._heartbeat: HeartbeatDescription | None = None
        self._own_limits: dict[Entry, int] = {}
        self._written: tuple[str, ...] = ()
        self.has_restarted = False
        self._emergency: tuple[int, int] | None = None
        self._heard_s = 0.0
        self._nmt_state: int | None = None
        self._silence_s = math.inf
        self._attained_is_fresh = False
        self._was_enabled = False
        self._homing_due_s = math.inf
        self._reports = DriveReports(link, node_id, (self.report_pdo, self.load_pdo))
        self._is_awaited = False
        self._current: tuple[Entry, float] | None = None
        link.network.subscribe(0x700 + node_id, self._on_heartbeat)
        link.network.subscribe(0x080 + node_id, self._on_emergency)
        link.network.subscribe(0x000, self._on_nmt)

    # Units

    @cached_property
    def scale(self) -> AxisScale:
        """The conversion to counts and speeds of the drive. Raises `InputError` if an entry is unknown."""
        return self.section.scale()

    def _counter(self, position: float) -> int:
        """Return the drive's counter at a position."""
        return self.scale.to_counts(position) - self._offset_counts

    def _position(self, counter: int) -> float:
        """Return the position at a value of the drive's counter."""
        return self.scale.to_position(counter + self._offset_counts)

    @property
    def _window_counts(self) -> int:
        return self.scale.to_distance_counts(self.section.position_window)

    # Overridden by kinds of drive

    def decode(self, statusword: int) -> DriveState:
        """Return the CiA 402 state of a statusword."""
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
            raise self._make_refusal(entry.name, error) from error
        except SdoSilenceError as error:
            raise self._make_silence(entry.name) from error

    def download(self, entry: Entry, value: int) -> None:
        """Write an object. Raises as `upload`."""
        entry = self.own_entry(entry)
        what = f"{entry.name} ({entry.place}) = {value}"
        try:
            self.sdo.download(entry.index, entry.subindex, entry.pack(value))
        except SdoAbortedError as error:
            raise self._make_refusal(what, error) from error
        except SdoSilenceError as error:
            raise self._make_silence(what) from error

    def _make_refusal(self, what: str, error: SdoAbortedError) -> DriveRefusedError:
        text = describe_abort(error.code)
        return DriveRefusedError(
            f"{self.name} refused {what}: {text} (SDO abort 0x{error.code:08X})",
            "check rig file and drive settings against each other",
            code=error.code,
            text=text,
        )

    def _make_silence(self, what: str) -> DriveSilentError:
        return DriveSilentError(
            f"{self.name} did not answer within {self._link.answer_timeout_s:g} s, asked {1 + RETRIES} times "
            f"({what})",
            _CHECK_POWER,
            axis=self.axis,
        )

    def counts(self) -> dict[str, int]:
        """Return how many requests were repeated, and how many answers were unexpected."""
        return {
            "retries": self.sdo.retries + self._reports.missed,
            "strays": self.sdo.strays + self._reports.strays,
        }

    # Connecting

    def wake(self) -> int:
        """Return the vendor id; first start a node that `labrig devices stop` has stopped, as it answers nothing."""
        return self._do_awake(lambda: self.upload(co.VENDOR_ID))

    def require_alone(self, strays: int) -> None:
        """Refuse a node id with which two nodes have answered, given the stray answers before.

        Answers to earlier requests do not count. Raises `DriveError`.
        """
        if self.sdo.strays - strays >= _CLASHING_ANSWERS:
            raise DriveError(
                f"{self.name}: two nodes answer as node {self.node_id}",
                "give every drive a node id of its own",
            )

    def cob_ids(self) -> tuple[frozenset[int], frozenset[int]]:
        """Return the COB-IDs of process data that the drive sends, and that it obeys."""
        sent, obeyed = self.pdo_entries()
        return self._cob_ids(sent), self._cob_ids(obeyed)

    def pdo_entries(self) -> tuple[tuple[Entry, ...], tuple[Entry, ...]]:
        """Return the COB-ID objects of the PDOs that the drive sends, and of those that it obeys."""
        every = (co.TRANSMIT_PDO_COB_IDS, co.RECEIVE_PDO_COB_IDS)
        sent, obeyed = (tuple(entry for entry in entries if self.has(entry)) for entries in every)
        return sent, obeyed

    def _cob_ids(self, entries: Iterable[Entry]) -> frozenset[int]:
        values = (self.upload(entry) for entry in entries)
        return frozenset(value & 0x7FF for value in values if not value & co.PDO_INVALID)

    def configure(self, heartbeat: HeartbeatDescription, max_current_ma: int | None) -> None:
        """Switch the drive off, write its settings, and make it stop by itself; its heartbeat is monitored now."""
        self.require_limits()
        self.hold_off()
        self._heartbeat = heartbeat
        self.watch(heartbeat.period_ms, heartbeat.timeout_ms / 1000)
        limit = self.limit_current(max_current_ma)
        self._settings = self.settings_of(heartbeat) | limit
        self._written = self.write_settings(self._settings)
        self.let_report()
        self.verify_dead_man(heartbeat)

    def settings_of(self, heartbeat: HeartbeatDescription) -> dict[Entry, int]:
        """Return the settings of the drive for its section, including the heartbeat consumer."""
        raise NotImplementedError

    def limit_current(self, max_current_ma: int | None) -> dict[Entry, int]:
        """Return the setting that limits the current, and keep the drive's own for `close`.

        Raises
        ------
        DriveError
            When the drive has no limit.
        """
        if max_current_ma is None:
            return {}
        found = self.find_current_limit()
        if found is None:
            raise DriveError(
                f"{self.name} has no current limit that labrig can set, asked for {max_current_ma} mA",
                f"set it in {self.tool}; --current-ma 0, and a rig file without max_current_ma, ask for none",
            )
        entry, milliamperes = found
        own = self.upload(entry)
        self._own_limits = {entry: own}
        return {entry: min(math.floor(max_current_ma / milliamperes), own)}

    def set_current_limit(self, limit_ma: int) -> None:
        """Set the limit of the output current, where the drive has one [mA]."""
        found = self.find_current_limit()
        if found is not None:
            self.adjust({found[0]: round(limit_ma / found[1])})

    def find_current_limit(self) -> tuple[Entry, float] | None:
        """Return the object that limits the current, and its unit [mA]; None without such an object."""
        return None

    def settings(self) -> dict[str, int]:
        """Return the required value of each setting; each was read back, and written if it differed."""
        return {entry.place: value for entry, value in self._settings.items()}

    def describe(self) -> dict[str, object]:
        """Return the settings of the drive, for the record."""
        return {
            "drive_settings": self.settings(),
            "settings_written": list(self._written),
            "dead_man": dict(self._dead_man),
            **self.counts(),
        }

    def close(self) -> None:
        """Switch power off, restore the current limit, and end both heartbeats without a fault."""
        self.disable()
        if self._own_limits:
            self.restore_limits(self._own_limits)
        self.unwatch()

    def restore_limits(self, own: Mapping[Entry, int]) -> None:
        """Write the drive's own limits again."""
        self.adjust(own)

    def hold_off(self) -> None:
        """Start the node, stop the axis, and switch the power stage off.

        Raises
        ------
        DriveError
            Also when the drive reports a fault.
        """
        self.send_nmt(_NMT_START)
        self.raise_if_faulted()
        self.stop()
        self.settle(ANSWER_TIME_S)
        self.go_to(TargetState.POWER_OFF)

    def write_settings(self, settings: Mapping[Entry, int]) -> tuple[str, ...]:
        """Read each setting and write those that differ; return the places of those that were written.

        Raises
        ------
        DriveError
        """
        return tuple(entry.place for entry, value in settings.items() if self.ensure(entry, value))

    def adjust(self, settings: Mapping[Entry, int]) -> bool:
        """Write the settings that operation needs and that differ; return whether any did. Raises `DriveError`."""
        return bool(self.write_settings(settings))

    def ensure(self, entry: Entry, value: int) -> bool:
        """Write an object if it differs, and read it back; return whether it was written."""
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
        """Make the drive stop by itself when the computer's heartbeat stops, obey nobody else, and read that back.

        Raises
        ------
        DriveError
            When it does not keep one of the settings, among them an option that means "no action".
        """
        self._dead_man = {}
        settings = self._heartbeat_settings(heartbeat) | self.stop_options() | self._unused_pdos()
        for entry, value in settings.items():
            self._clock.sleep(0.0)  # lets a heartbeat that is due be sent
            try:
                self.adjust({entry: value})
            except DriveRefusedError as error:
                if error.code != NO_OBJECT:
                    raise self._unsafe(entry, error) from error
                self._dead_man[entry.place] = None
            except DriveError as error:
                raise self._unsafe(entry, error) from error
            else:
                self._dead_man[entry.place] = value

    def stop_options(self) -> dict[Entry, int]:
        """Return the option codes by which the drive stops, as a run sets them; none by default."""
        return {}

    def _heartbeat_settings(self, heartbeat: HeartbeatDescription) -> dict[Entry, int]:
        return {co.CONSUMER_HEARTBEAT: heartbeat.computer_node_id << 16 | heartbeat.timeout_ms}

    def _unused_pdos(self) -> dict[Entry, int]:
        """Return the COB-IDs that switch off every PDO but the report: labrig commands by SDO alone."""
        used = {co.TRANSMIT_PDO_COB_IDS[pdo] for pdo in (self.report_pdo, *self._reports.layouts)}
        sent, obeyed = self.pdo_entries()
        unused = [
            entry for entry in (*obeyed, *sent) if entry not in used and self.own_entry(entry).access == "rw"
        ]
        values = {entry: self.upload(entry) for entry in unused}
        return {entry: value | co.PDO_INVALID for entry, value in values.items()}

    def _unsafe(self, entry: Entry, error: DriveError) -> DriveError:
        """Return the error of a drive that does not take what makes it stop by itself."""
        if entry == co.ABORT_CONNECTION and self.upload(entry) == _NO_ACTION:
            return error.reword(
                f"{self.name} takes no action when the computer falls silent ({entry.place} = {_NO_ACTION}): "
                f"{error.message}",
                f"set {entry.place} in {self.tool} and save it; nothing else stops this drive if labrig ends",
            )
        return error.reword(
            f"{error.message}; its dead-man cannot be relied upon",
            f"set {entry.place} in {self.tool} and save it",
        )

    def watch(self, period_ms: int, silence_s: float) -> None:
        """Switch the drive's heartbeat on; it counts as silent after `silence_s` without one."""
        self.adjust({co.PRODUCER_HEARTBEAT: period_ms})
        self._heard_s = self._clock.now_s()
        self._silence_s = silence_s

    def unwatch(self) -> None:
        """End both heartbeats without a fault: the drive is left without power."""
        self._silence_s = math.inf
        self.adjust({co.CONSUMER_HEARTBEAT: 0, co.PRODUCER_HEARTBEAT: 0})

    # States

    def go_to(self, goal: TargetState) -> None:
        """Bring the drive to a goal of its state machine.

        Raises
        ------
        DriveError
            On a fault if it is to be enabled, or when it stays in a state, or returns to it, for too long.
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
        """Switch the power stage on; the axis holds its position."""
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
        """Return the position of the axis [mm or rad]."""
        return self._position(self.counter())

    def statusword(self) -> int:
        """Return the statusword."""
        statusword = self.upload(co.STATUSWORD)
        self._note_state(statusword)
        return statusword

    def let_report(self) -> None:
        """Make the drive report at each SYNC, if a PDO has statusword and position and can be switched on.

        Raises
        ------
        DriveError, BusError
        """
        self._current = self.find_current()
        entries = map(self.own_entry, (*_REPORTED, *self._load_entries()))
        layouts = pack_into_pdos(entries, (self.report_pdo, self.load_pdo))
        self._reports.listen(
            {
                pdo: layout
                for pdo, layout in layouts.items()
                if self._map(pdo, layout) and self._switch_on(pdo)
            }
        )

    def _load_entries(self, *, with_current: bool = True) -> tuple[Entry, ...]:
        """Return the objects of motor current and inputs that are to be reported, each once."""
        current = () if self._current is None or not with_current else (self._current[0],)
        return (*current, *self._input_entries)

    @cached_property
    def _input_entries(self) -> tuple[Entry, ...]:
        """The objects that hold those inputs, each once. Raises as `_input_places`."""
        return tuple(dict.fromkeys(place.entry for place in self._input_places.values()))

    @cached_property
    def _input_places(self) -> dict[str, InputPlace]:
        """Where the inputs are read that its section names. Raises `DriveError` if the drive lacks one."""
        places = {}
        for name, channel in self.section.inputs.items():
            place = self.find_input(channel.source)
            if place is None:
                raise DriveError(
                    f"{self.name} has no input {channel.source}, which the rig file names {name}",
                    "wire it to an input that the drive has, and name that one",
                )
            places[name] = place
        return places

    def _map(self, pdo: int, layout: tuple[Entry, ...]) -> bool:
        """Tell whether a PDO carries these objects; map them if it does not, and the first ones are there already."""
        mapping = co.TPDO_MAPS[pdo][: 1 + len(layout)]
        places = [entry for entry in mapping if self.has(entry)]
        wanted = [len(layout), *map(mapping_of, layout)]
        found = [self.upload(entry) for entry in places]
        if found == wanted:
            return True
        own = [len(_REPORTED), *wanted[1 : 1 + len(_REPORTED)]]
        is_free = pdo != self.report_pdo or found[: len(own)] == own
        if not (is_free and len(places) == len(mapping)):
            return False
        number = places[0]
        cob_id = co.TRANSMIT_PDO_COB_IDS[pdo]
        self.send_nmt(_NMT_PRE_OPERATIONAL)
        try:
            self.adjust({cob_id: self.upload(cob_id) | co.PDO_INVALID})
            self.adjust({number: 0})
            self.adjust(dict(zip(places[1:], wanted[1:], strict=True)))
            self.adjust({number: len(layout)})
        except DriveRefusedError:
            return False
        finally:
            self.send_nmt(_NMT_START)
        return True

    def _switch_on(self, pdo: int) -> bool:
        """Tell whether a PDO is sent at each SYNC from now on."""
        cob_id = _NO_REMOTE | 0x180 + 0x100 * pdo + self.node_id
        try:
            self.adjust({co.TPDO_TYPES[pdo]: _AT_EACH_SYNC, co.TRANSMIT_PDO_COB_IDS[pdo]: cob_id})
        except DriveRefusedError:
            return False
        return True

    def expect_report(self) -> None:
        """Drop earlier reports: the next `report` is that of the coming SYNC."""
        self._is_awaited = True
        self._reports.expect()

    def report(self) -> dict[Entry, int]:
        """Return statusword, position [counts] and load, as reported; by SDO what is not expected or does not arrive.

        The motor current is only in a report that was expected: who looks in between asks for it if the axis lags.

        Raises
        ------
        DriveError, BusError
        """
        values = self._reports.take(_REPORT_PATIENCE * self._link.answer_timeout_s)
        with_current, self._is_awaited = self._is_awaited, False
        for entry in (*_REPORTED, *self._load_entries(with_current=with_current)):
            if entry not in values:
                values[entry] = self.upload(entry)
        self._note_state(values[co.STATUSWORD])
        return values

    def _note_state(self, statusword: int) -> None:
        self._was_enabled = self.decode(statusword) is DriveState.OPERATION_ENABLED

    # Moving

    def round_move(self, position: float, speed: float) -> RoundedMove:
        """Return the nearest move in whole counts and units of speed."""
        counter, units = self._counter(position), self.scale.to_speed_units(speed)
        return RoundedMove(
            self._position(counter), self.scale.to_speed(units), self.name_sent(counter, units)
        )

    def name_sent(self, counter: int, speed_units: int) -> dict[str, int]:
        """Return what goes over the wire, by its names in the record."""
        return {"sent_counts": counter, "sent_speed_units": speed_units}

    def start_move(self, position: float, speed: float) -> None:
        """Start a move to an absolute position [mm or rad, per s]."""
        self._target = self._counter(position)
        self.start_profile(self._target, self.scale.to_speed_units(speed))

    def target(self) -> float | None:
        """Return the target position that the drive now has [mm or rad]."""
        return self._position(self.upload(co.TARGET_POSITION))

    def read(self) -> DriveReading:
        """Read statusword, position and load. Raises `DriveError` if the drive cannot move."""
        values = self.report()
        statusword, counter = values[co.STATUSWORD], values[co.POSITION_ACTUAL]
        self.refuse_unless_enabled(statusword)
        arrived = self._target is None or (
            bool(statusword & TARGET_REACHED) and abs(counter - self._target) <= self._window_counts
        )
        current_ma = None
        if self._current is not None and self._current[0] in values:
            current_ma = values[self._current[0]] * self._current[1]
        inputs = self._convert_inputs(values)
        return DriveReading(
            self._position(counter), statusword, self.decode(statusword), arrived, current_ma, inputs
        )

    def read_inputs(self) -> dict[str, InputValue]:
        """Return what the inputs read that its section names."""
        return self._convert_inputs({entry: self.upload(entry) for entry in self._input_entries})

    def _convert_inputs(self, values: Mapping[Entry, int]) -> dict[str, InputValue]:
        channels = self.section.inputs
        return {
            name: channels[name].convert(values[place.entry] * place.volts)
            if place.bit is None
            else bool(values[place.entry] >> place.bit & 1)
            for name, place in self._input_places.items()
        }

    def lag(self) -> float | None:
        """Return the following error, with its sign [mm or rad]; None if the drive does not tell it."""
        entry = self.find_following_error()
        return None if entry is None else self.upload(entry) / self.scale.counts_per_unit

    def start_profile(self, target: int, speed_units: int) -> None:
        """Start a profile to an absolute position, with both edges of the set-point handshake.

        Parameters
        ----------
        target : int
            Target [counts].
        speed_units : int
            Speed of the motor in units of the drive.

        Raises
        ------
        DriveError
        """
        # The drive takes a set-point at the rising edge of its bit; an acknowledge of an earlier one would seem
        # to be its own.
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

    def stop(self, *, quick: bool = False) -> None:
        """Decelerate and hold, if power is on; a quick stop leaves operation enabled, and wakes a stopped node."""
        if quick:
            self._do_awake(lambda: self.go_to(TargetState.QUICK_STOPPED))
        elif self.decode(self.statusword()) is DriveState.OPERATION_ENABLED:
            self.download(co.CONTROLWORD, ENABLE | HALT)

    def _do_awake(self, act: Callable[[], _T]) -> _T:
        """Do something, and again once the node has been started if it does not answer and may be in NMT stopped."""
        try:
            return act()
        except DriveSilentError:
            if self._nmt_state == _NMT_OPERATIONAL:
                raise
            self.send_nmt(_NMT_PRE_OPERATIONAL)
            return act()

    def post_stop(self, *, quick: bool = False) -> None:
        """Send Halt to a drive that was last known enabled, or a quick stop to any, and wait for no answer.

        A node that somebody has stopped takes no request until it is started again. Raises `BusError`.
        """
        if quick or self._was_enabled:
            if self._nmt_state == _NMT_STOPPED:
                self.send_nmt(_NMT_START)
            data = self.own_entry(co.CONTROLWORD).pack(QUICK_STOP if quick else ENABLE | HALT)
            self.sdo.post(co.CONTROLWORD.index, co.CONTROLWORD.subindex, data)

    def settle(self, within_s: float) -> None:
        """Return when the axis stands still. Raises `DriveError` if it still moves after `within_s`."""
        for _ in self.wait_until_still(within_s):
            self._clock.sleep(STILL_POLL_S)

    def wait_until_still(self, within_s: float) -> Iterator[None]:
        """Poll the position until all readings of `still_time_s` lie within the dither.

        Ends when the axis stands still; until then the caller lets `STILL_POLL_S` pass after each reading.

        Raises
        ------
        DriveError
            When it still moves after `within_s`.
        """
        deadline_s = self._clock.now_s() + within_s
        readings = deque([self.counter()], maxlen=self._readings_until_still)
        while len(readings) < self._readings_until_still or max(readings) - min(readings) > STILL_COUNTS:
            if self._clock.now_s() > deadline_s:
                raise DriveError(
                    f"{self.name} still moves {within_s:.1f} s after it was stopped "
                    f"({readings[0]} -> {readings[-1]} {self.section.count_unit})",
                    "press the emergency stop",
                )
            yield
            readings.append(self.counter())

    # Reference

    def homing_settings(self, homing: Homing) -> Iterator[tuple[Entry, int]]:
        """Yield the settings that a homing needs besides mode and method; each kind has its own objects."""
        raise NotImplementedError

    def home_counter(self, homing: Homing) -> int:
        """Return the counter at home."""
        return self.scale.to_counts(homing.position)

    def home(self, homing: Homing) -> Iterator[None]:
        """Home, and hold at home in profile position mode. Raises as `has_homed` and `finish_homing`."""
        self.start_homing(homing)
        while not self.has_homed():
            yield
        self.finish_homing(homing)

    def start_homing(self, homing: Homing) -> None:
        """Start homing; `has_homed` tells when home is found, then call `finish_homing`."""
        self._offset_counts, self._target = 0, None
        self._homing_due_s = self._clock.now_s() + homing.timeout_s
        method = {co.MODE: _HOMING, co.HOMING_METHOD: self.homing_method(homing.method)}
        self.adjust(method | dict(self.homing_settings(homing)))
        self.download(co.CONTROLWORD, ENABLE)
        # An attained bit from an earlier homing does not count until it has fallen.
        self._attained_is_fresh = not self.statusword() & HOMING_ATTAINED or homing.method == HOMING_HERE
        self.download(co.CONTROLWORD, ENABLE | NEW_SETPOINT)

    def homing_method(self, method: int) -> int:
        """Return the drive's own number of a homing method."""
        return method

    def has_homed(self) -> bool:
        """Tell whether home has been found since `start_homing`.

        Raises
        ------
        DriveError
            When the drive reports that it cannot be found, is in fault, or exceeds the timeout of the homing.
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
        """Check the counter, and hold at home in profile position mode."""
        self.settle(ANSWER_TIME_S)
        # Even a fresh bit can be wrong; the counter shows whether home was set.
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
        """Tell whether the drive has its reference, which it loses with its power."""
        return bool(self.statusword() & REFERENCED)

    def assume_position(self, position: float) -> None:
        """Assume that the axis is at this position [mm or rad]; the drive keeps its counter."""
        self._offset_counts = self.scale.to_counts(position) - self.counter()
        self._target = None

    def set_limits(self, limits: tuple[float, float] | None) -> None:
        """Set the limits of the drive, wider by the window: a count beyond them is a fault. None removes them."""
        if limits is None:
            self.adjust({entry: entry.default for entry in (co.LOWER_LIMIT, co.UPPER_LIMIT)})
            return
        low, high = sorted(map(self.scale.to_counts, limits))
        window = self._window_counts
        self.write_settings({co.LOWER_LIMIT: low - window, co.UPPER_LIMIT: high + window})

    # Faults

    def raise_if_faulted(self) -> None:
        """Raise a fault that the drive has reported or that its statusword shows.

        Raises
        ------
        DriveError
            Names the error code, its meaning and the remedy.
        """
        self.check()
        self._refuse_fault(self.statusword())

    def check(self) -> None:
        """Raise a restart, emergency or silence that was noticed; send nothing to the drive.

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
            raise self._make_fault(*self._emergency)
        silent_s = self._clock.now_s() - self._heard_s
        if silent_s > self._silence_s:
            raise DriveSilentError(
                f"{self.name} has sent no heartbeat for {silent_s:.2f} s, expected one every "
                f"{self._silence_s:g} s at the latest",
                _CHECK_POWER,
                fault=HEARTBEAT_LOST,
                axis=self.axis,
            )

    def refuse_unless_enabled(self, statusword: int) -> None:
        """Refuse a statusword with which the drive cannot move. Raises `DriveError`."""
        self.check()
        self._refuse_unless_enabled(statusword)

    def _refuse_unless_enabled(self, statusword: int) -> None:
        state = self.decode(statusword)
        if state is DriveState.OPERATION_ENABLED:
            return
        self._refuse_fault(statusword)
        raise DriveError(
            f"{self.name} is in {state.name} (statusword 0x{statusword:04X}), expected OPERATION_ENABLED",
            "open the rig again once the cause is known",
        )

    def _refuse_fault(self, statusword: int) -> None:
        if self.decode(statusword) in FAULTED:
            raise self._make_fault(self.error_code(), self.upload(co.ERROR_REGISTER))

    def error_code(self) -> int:
        """Return the code of the newest error that the drive reports; 0 without one."""
        return self.upload(co.LAST_ERROR) & 0xFFFF if self.upload(co.ERROR_COUNT) else 0

    def describe_emergency(self, code: int) -> Emergency:
        """Return what an error code means; each kind has its own table."""
        return Emergency(code, 0x01, "unknown to labrig", "look it up in the manual of the drive")

    def _make_fault(self, code: int, register: int) -> DriveFaultError:
        emergency = self.describe_emergency(code)
        return DriveFaultError(
            f"{self.name} is in fault: {emergency} (error register 0x{register:02X})",
            emergency.remedy,
            code=code,
            register=register,
            text=emergency.text,
        )

    def find_current(self) -> tuple[Entry, float] | None:
        """Return the object of the motor current, and its unit [mA]; None without such an object."""
        return None

    def find_following_error(self) -> Entry | None:
        """Return the object of the following error [counts]; None without one."""
        return None

    def find_input(self, source: str) -> InputPlace | None:  # noqa: ARG002 - for drives that have some
        """Return where an input of the drive is read; None for one that it does not have."""
        return None

    def current_ma(self) -> float | None:
        """Return the motor current, with its sign [mA]; None if the drive does not measure it."""
        found = self.find_current()
        return None if found is None else self.upload(found[0]) * found[1]

    def require_limits(self) -> None:
        """Refuse a current limit of the rig file above the drive's own.

        Raises
        ------
        DriveError
            Names both.
        """
        asked_ma, own_ma = self.section.max_current_ma, self.current_limit_ma()
        if asked_ma is not None and own_ma is not None and asked_ma > own_ma:
            raise DriveError(
                f"{self.name} limits its current to {own_ma} mA, the rig file says max_current_ma {asked_ma}",
                f"write {own_ma} or less into the rig file, or raise the limit in {self.tool} if the motor bears it",
            )

    def current_limit_ma(self) -> int | None:
        """Return the limit of the output current [mA]; None if the drive has none."""
        found = self.find_current_limit()
        return None if found is None else math.floor(self.upload(found[0]) * found[1])

    def faults(self) -> tuple[DriveFaultError, ...]:
        """Return the newest fault, if the statusword shows one."""
        try:
            self._refuse_fault(self.upload(co.STATUSWORD))
        except DriveFaultError as fault:
            return (fault,)
        return ()

    def reset_fault(self) -> None:
        """Reset a fault that a person has confirmed; power stays off and nothing moves.

        Raises
        ------
        DriveFaultError
            When the cause persists.
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
        for fault in self.faults():
            raise fault.reword(f"{fault.message}; it could not be reset, its cause is still there")

    def _restore_communication(self) -> None:
        """Restore what the reset of the communication cleared: heartbeats and report, once configured."""
        if self._heartbeat is not None:
            self.watch(self._heartbeat.period_ms, self._heartbeat.timeout_ms / 1000)
            self.adjust(self._heartbeat_settings(self._heartbeat))
            self.let_report()

    def _on_heartbeat(self, _can_id: int, data: bytearray, _timestamp: float) -> None:
        self._heard_s = self._clock.now_s()
        if data[:1] == b"\0":
            self.has_restarted = True
        elif data:
            self._nmt_state = data[0] & 0x7F

    def _on_nmt(self, _can_id: int, data: bytearray, _timestamp: float) -> None:
        """Note the NMT command of somebody else: labrig's own do not come back."""
        if len(data) == 2 and data[1] in {0, self.node_id}:
            self._nmt_state = _NMT_STOPPED if data[0] == _NMT_STOP else _NMT_OPERATIONAL

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
