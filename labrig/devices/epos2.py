"""The driver of one EPOS2 (maxon) over CANopen, in quadcounts and rpm.

What is decided here
--------------------
- SDO through our own client; `canopen`'s `BaseNode402` is not used, because it resets faults, enables
  power and reads signs of homing methods by itself, wrongly for maxon.
- While axes move, statusword and position come at each SYNC as TxPDO 3, one frame a drive instead of four; a
  report that does not come is asked for by SDO, and counted. Its map is not written: where it is not the
  default one, or the drive refuses to switch the report on, SDO does it all.
- Nothing is believed that has not been read back: each setting after writing, the set-point acknowledge with
  both edges, the position at the end of a move, standing still after a stop.
- Power is never switched on but by `enable`, which holds Halt and has the actual position as target, so that
  nothing moves until a move is commanded. A fault is reset by `reset_fault` alone, once a person has confirmed.
- Only settings that differ are written, because writing clears the drive's configuration fingerprint
  (0x1020); the fingerprint is renewed last.
- A drive is watched: its heartbeat, its EMCY and its boot-up become errors as soon as the rig looks.
- A question without an answer is asked once more, and that is counted.
- Unsure until tried on a device: that 0x2210:01 holds the encoder resolution on every EPOS2; that the measure
  init state may show bit 14; that bit 12 falls when a homing starts, which a fresh attained bit needs (where
  it does not, homing ends in its timeout with the axis halted); that TxPDO 3 carries statusword and position by
  default and may be switched on while the node is operational (where not, SDO does it all); which objects clear
  0x1020 when they are written (it is renewed after each that labrig writes in operation); that two nodes of one id
  both answer (on a wire they may as well destroy each other's frames, and are silent then).
"""

import math
import struct
from collections import deque
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from queue import SimpleQueue

from labrig.clock import Clock
from labrig.devices import epos2_objects as od
from labrig.devices.bus import CanLink
from labrig.devices.cia402 import (
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
    Goal,
    decode_state,
    plan_controlword,
)
from labrig.devices.epos2_errors import describe_abort, describe_emergency
from labrig.devices.homing import BY_CURRENT, HOMING_HERE, Homing
from labrig.devices.sdo_client import RETRIES, SdoAbortedError, SdoClient, SdoSilenceError
from labrig.errors import (
    HEARTBEAT_LOST,
    DriveError,
    DriveFaultError,
    DriveRefusedError,
    DriveRestartedError,
    DriveSilentError,
    MachineError,
)

POLL_S = 0.005
ANSWER_TIME_S = 1.0
"""Rig time within which a drive attains a state, acknowledges a set-point or finishes homing on the spot."""

STILL_COUNTS = 2
"""A servo at rest dithers by so much [quadcounts]."""

_SLOWEST_RPM = 1
LOOK_S = 0.05
"""How often a position is looked at until it stands still [s]."""

_LONGEST_STILL_TIME_S = 0.4
_RESET_TIME_S = 0.05
"""How long a drive is given to take the reset of a fault."""

_PROFILE_POSITION, _HOMING = 1, 6
_NMT_START, _NMT_PRE_OPERATIONAL, _NMT_RESET_COMMUNICATION = 0x01, 0x80, 0x82
_RESET_COMMUNICATION_FIRST = frozenset({0x8120, 0x81FD})
"""Faults of the bus whose reset the drive takes only after its communication has been reset."""

_PDO_UNUSED = 0x80000000
_CLASHING_ANSWERS = 3
"""Answers that nobody asked for among the five to who a drive is: one may be a frame that came twice."""

_CHECK_POWER = "check power, CAN wiring, bit rate and node id of the drive"
_EMERGENCY = struct.Struct("<HB")

_REPORT_PDO = 2
_REPORT_MAP = (2, od.STATUSWORD.index << 16 | 16, od.POSITION_ACTUAL.index << 16 | 32)
_REPORT, _REPORT_COB_ID, _NO_REMOTE, _AT_EACH_SYNC = struct.Struct("<Hi"), 0x380, 0x40000000, 1
_REPORT_PATIENCE = 0.25
"""Part of the time for an answer that a report may take: it is a frame that is already on its way."""


def still_time_s(encoder_pulses: int | None) -> float:
    """Return for how long a position must stay within `STILL_COUNTS` before an axis is said to stand still [s].

    In this time the slowest speed that an EPOS2 can be told, 1 rpm, turns the encoder by more than the dither at
    either end of the time: a creep never counts as standing still. An encoder below 188 pulses a turn, or an unknown
    one (None), gets the longest time, in which a creep of 188 / pulses rpm is seen.
    """
    if encoder_pulses is None:
        return _LONGEST_STILL_TIME_S
    quadcounts_per_s = 4 * encoder_pulses * _SLOWEST_RPM / 60
    return min((2 * STILL_COUNTS + 1) / quadcounts_per_s, _LONGEST_STILL_TIME_S)


def wait_for_all(looks: Mapping[str, Iterator[None]], clock: Clock) -> dict[str, str]:
    """Let all look until they stand still, at the same time, and return what is wrong with those that do not.

    Parameters
    ----------
    looks : mapping of str to iterator
        By name, as `Epos2.looks_until_still` has them.
    clock : Clock
        Lets the time between two looks pass.
    """
    failures: dict[str, str] = {}
    moving = dict(looks)
    while moving:
        for name, one in tuple(moving.items()):
            try:
                next(one)
            except StopIteration:
                del moving[name]
            except MachineError as error:
                failures[name] = error.message
                del moving[name]
        if moving:
            clock.sleep(LOOK_S)
    return failures


@dataclass(frozen=True)
class Identity:
    """What a drive says it is."""

    model: str
    hardware_version: int
    software_version: int
    serial_number: int


class Epos2:
    """One drive.

    Parameters
    ----------
    link : CanLink
        The bus.
    node_id : int
        Its node id.
    name : str
        The axis that it drives, for messages.
    clock : Clock
        Whose time bounds waiting.
    encoder_pulses : int or None
        Pulses of its encoder a turn, by which a creep is told from standing still; None where nobody knows.
    """

    def __init__(
        self, link: CanLink, node_id: int, name: str, clock: Clock, encoder_pulses: int | None = None
    ) -> None:
        self.name = f"drive of axis {name} (node {node_id})"
        self.node_id = node_id
        self._clock = clock
        self._link = link
        self._sdo = SdoClient(link, node_id)
        self._looks_until_still = 1 + math.ceil(still_time_s(encoder_pulses) / LOOK_S)
        self._restarted = False
        self._emergency: tuple[int, int] | None = None
        self._heard_s = 0.0
        self._silence_s = math.inf
        self._attained_is_fresh = False
        self._was_enabled = False
        self._vouched: tuple[int, int] | None = None
        self._homing_due_s = math.inf
        self._reports: SimpleQueue[bytes] = SimpleQueue()
        self._has_reports = self._awaits_report = False
        self._missed_reports = self._stray_reports = 0
        report_id = _REPORT_COB_ID + node_id
        link.network.subscribe(report_id, lambda _id, data, _t: self._reports.put(bytes(data)))
        link.network.subscribe(0x700 + node_id, self._on_heartbeat)
        link.network.subscribe(0x080 + node_id, self._on_emergency)

    # Objects

    def read(self, entry: od.Entry) -> int:
        """Return the value of an object.

        Raises
        ------
        DriveSilentError, DriveRefusedError, BusError
        """
        try:
            return entry.unpack(self._sdo.upload(entry.index, entry.subindex))
        except SdoAbortedError as error:
            raise self._refused(entry.name, error) from error
        except SdoSilenceError as error:
            raise self._silent(entry.name) from error

    def write(self, entry: od.Entry, value: int) -> None:
        """Write an object. Raises as `read`."""
        what = f"{entry.name} ({entry.place}) = {value}"
        try:
            self._sdo.download(entry.index, entry.subindex, entry.pack(value))
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
            "retries": self._sdo.retries + self._missed_reports,
            "strays": self._sdo.strays + self._stray_reports,
        }

    # Connecting

    def identify(self) -> Identity:
        """Return what the drive is.

        Raises
        ------
        DriveError
            When it is no EPOS2: other generations have other objects and signs; or when two drives answer.
        """
        vendor = self._first_answer()
        # Answers to whoever asked before do not count.
        strays = self._sdo.strays
        device_type = self.read(od.DEVICE_TYPE)
        if vendor != od.VENDOR_ID.default or device_type != od.DEVICE_TYPE.default:
            raise self._not_an_epos2(f"vendor 0x{vendor:X}, device type 0x{device_type:08X}")
        hardware = self.read(od.HARDWARE_VERSION)
        model = od.EPOS2_HARDWARE.get(hardware & 0xFFF0)
        if model is None:
            other = od.OTHER_HARDWARE.get(hardware & 0xFFF0, "unknown to labrig")
            raise self._not_an_epos2(f"hardware version 0x{hardware:04X}, {other}")
        identity = Identity(model, hardware, self.read(od.SOFTWARE_VERSION), self.read(od.SERIAL_NUMBER))
        if self._sdo.strays - strays >= _CLASHING_ANSWERS:
            raise DriveError(
                f"{self.name}: two nodes answer as node {self.node_id}",
                "give every drive a node id of its own",
            )
        return identity

    def _first_answer(self) -> int:
        """Return the vendor id; a node that `labrig devices stop` has stopped answers nothing until it is woken."""
        try:
            return self.read(od.VENDOR_ID)
        except DriveSilentError:
            self.send_nmt(_NMT_PRE_OPERATIONAL)
            return self.read(od.VENDOR_ID)

    def _not_an_epos2(self, found: str) -> DriveError:
        return DriveError(
            f"{self.name} is no EPOS2: {found}", "check the node id in the rig file and the drive itself"
        )

    def require_encoder(self, pulses: int) -> None:
        """Refuse a drive that is set to another encoder resolution; it is never written.

        Raises
        ------
        DriveError
        """
        found = self.read(od.ENCODER_PULSES)
        if found != pulses:
            raise DriveError(
                f"{self.name} is set to {found} encoder pulses a turn, the rig file says {pulses}",
                "find out which encoder it has; correct the rig file, or the drive in EPOS Studio",
            )

    def require_fingerprint(self, expected: tuple[int, int]) -> None:
        """Refuse a drive whose configuration is not the one that was left in it.

        Raises
        ------
        DriveError
        """
        found = self.fingerprint()
        if found != expected:
            raise DriveError(
                f"{self.name} has the configuration fingerprint {list(found)} (0x1020), the rig file says "
                f"{list(expected)}: its parameters have been changed",
                "power it off and on, which brings back those that it has stored; else compare them in EPOS Studio "
                "and enter the new fingerprint in the rig file",
            )

    def pdo_cob_ids(self) -> frozenset[int]:
        """Return the COB-IDs on which this drive sends process data; two drives must not share one."""
        values = (self.read(entry) for entry in od.TRANSMIT_PDO_COB_IDS)
        return frozenset(value & 0x7FF for value in values if not value & _PDO_UNUSED)

    def command_cob_ids(self) -> frozenset[int]:
        """Return the COB-IDs on which this drive takes process data; two drives would both obey a shared one."""
        values = (self.read(entry) for entry in od.RECEIVE_PDO_COB_IDS)
        return frozenset(value & 0x7FF for value in values if not value & _PDO_UNUSED)

    def hold_off(self) -> None:
        """Start the node, stop what moves, and switch the power stage off.

        Raises
        ------
        DriveError
            Also when it reports a fault.
        """
        self.send_nmt(_NMT_START)
        self.raise_if_faulted()
        self.halt()
        self.wait_until_still(ANSWER_TIME_S)
        self.go_to(Goal.POWER_OFF)

    def configure(self, settings: Mapping[od.Entry, int], fingerprint: tuple[int, int]) -> tuple[str, ...]:
        """Bring settings to what they must be, each read back; return the places of those that were written.

        Parameters
        ----------
        settings : mapping of Entry to int
            Written where they differ.
        fingerprint : tuple of int
            What 0x1020 is to hold: the drive clears it when a setting is changed behind our back.

        Raises
        ------
        DriveError
        """
        written = tuple(entry.place for entry, value in settings.items() if self.ensure(entry, value))
        self._vouched = fingerprint
        self._renew_fingerprint()
        return written

    def adjust(self, settings: Mapping[od.Entry, int]) -> None:
        """Bring settings to what operation asks for; the fingerprint that was left in the drive stays there.

        Raises
        ------
        DriveError
        """
        written = [entry for entry, value in settings.items() if self.ensure(entry, value)]
        if written:
            self._renew_fingerprint()

    def fingerprint(self) -> tuple[int, int]:
        """Return date and time of 0x1020, which the drive clears when a setting is changed."""
        return self.read(od.CONFIGURATION_DATE), self.read(od.CONFIGURATION_TIME)

    def _renew_fingerprint(self) -> None:
        """Write 0x1020 again; never into a drive that has restarted, for whose settings nobody can vouch."""
        if self._vouched is not None and not self._restarted:
            self.ensure(od.CONFIGURATION_DATE, self._vouched[0])
            self.ensure(od.CONFIGURATION_TIME, self._vouched[1])

    def ensure(self, entry: od.Entry, value: int) -> bool:
        """Write an object where it differs, and read it back; return whether it was written."""
        if self.read(entry) == value:
            return False
        self.write(entry, value)
        found = self.read(entry)
        if found != value:
            raise DriveError(
                f"{self.name} kept {entry.name} ({entry.place}) at {found} when {value} was written",
                "check whether the drive's parameters are locked in EPOS Studio",
            )
        return True

    def send_nmt(self, command: int) -> None:
        """Send an NMT command to this node; NMT is not answered."""
        self._link.send(0x000, bytes([command, self.node_id]))

    # Heartbeats

    def watch(self, period_ms: int, silence_s: float) -> None:
        """Let the drive beat, and count it as silent when no beat is heard for `silence_s`."""
        self.adjust({od.PRODUCER_HEARTBEAT: period_ms})
        self._heard_s = self._clock.now_s()
        self._silence_s = silence_s

    def unwatch(self) -> None:
        """Let both heartbeats end: the drive is left alone without power, which is no fault."""
        self._silence_s = math.inf
        self.adjust({od.CONSUMER_HEARTBEAT: 0, od.PRODUCER_HEARTBEAT: 0})

    # States

    def go_to(self, goal: Goal) -> None:
        """Bring the drive to a goal of its state machine.

        Raises
        ------
        DriveError
            On a fault when it is to be enabled, or when it has been in a state for too long, also on and off.
        """
        since_s: dict[DriveState, float] = {}
        while True:
            statusword = self.statusword()
            state, now_s = decode_state(statusword), self._clock.now_s()
            if goal is Goal.ENABLED:
                self._refuse_fault(statusword)
            plan = plan_controlword(statusword, goal)
            if plan.attained:
                return
            if now_s - since_s.setdefault(state, now_s) > ANSWER_TIME_S:
                raise DriveError(
                    f"{self.name} stayed in {state.name} for {ANSWER_TIME_S:g} s "
                    f"on the way to {goal.name} (statusword 0x{statusword:04X})",
                    "look at its status in EPOS Studio",
                )
            if plan.controlword is not None:
                self.write(od.CONTROLWORD, plan.controlword)
            self._clock.sleep(POLL_S)

    def enable(self) -> None:
        """Switch the power stage on; the axis holds where it is."""
        self.ensure(od.MODE, _PROFILE_POSITION)
        self.write(od.CONTROLWORD, HALT)
        self.write(od.TARGET_POSITION, self.read(od.POSITION_ACTUAL))
        self.go_to(Goal.ENABLED)

    def position(self) -> int:
        """Return the actual position [quadcounts]."""
        return self.read(od.POSITION_ACTUAL)

    def statusword(self) -> int:
        """Return the statusword."""
        statusword = self.read(od.STATUSWORD)
        self._note_state(statusword)
        return statusword

    def let_report(self) -> None:
        """Let the drive report at each SYNC, where its TxPDO 3 carries statusword and position and may be switched on.

        Raises
        ------
        DriveError, BusError
        """
        found = tuple(self.read(entry) for entry in od.TPDO_MAPS[_REPORT_PDO][: len(_REPORT_MAP)])
        self._has_reports = found == _REPORT_MAP
        if not self._has_reports:
            return
        cob_id = _NO_REMOTE | _REPORT_COB_ID + self.node_id
        try:
            self.adjust(
                {od.TPDO_TYPES[_REPORT_PDO]: _AT_EACH_SYNC, od.TRANSMIT_PDO_COB_IDS[_REPORT_PDO]: cob_id}
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
        """Return statusword and position [quadcounts]: as reported, or asked for when no report is expected or comes.

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
        return self.statusword(), self.position()

    def _note_state(self, statusword: int) -> None:
        self._was_enabled = decode_state(statusword) is DriveState.OPERATION_ENABLED

    def is_referenced(self) -> bool:
        """Tell whether the drive itself knows its position to be referenced; lost with its power."""
        return bool(self.statusword() & REFERENCED)

    # Moving

    def start_move(self, target: int, rpm: int) -> None:
        """Start a profile to an absolute position, with both edges of the set-point handshake.

        Parameters
        ----------
        target : int
            Where to [quadcounts].
        rpm : int
            Speed of the motor.

        Raises
        ------
        DriveError
        """
        # A set-point is taken at the rising edge of its bit; an acknowledge left from another would look like
        # success.
        self._wait_for_bit(SETPOINT_ACKNOWLEDGED, 0, "get ready for a set-point")
        self._refuse_unless_enabled(self.statusword())
        self.ensure(od.MODE, _PROFILE_POSITION)
        self.adjust({od.PROFILE_VELOCITY: rpm})
        self.write(od.TARGET_POSITION, target)
        self.write(od.CONTROLWORD, ENABLE | NEW_SETPOINT | CHANGE_IMMEDIATELY)
        self._wait_for_bit(SETPOINT_ACKNOWLEDGED, SETPOINT_ACKNOWLEDGED, "acknowledge the set-point")
        self.write(od.CONTROLWORD, ENABLE)
        self._wait_for_bit(SETPOINT_ACKNOWLEDGED, 0, "take back the acknowledge of the set-point")

    def start_homing(self, homing: Homing) -> None:
        """Begin to look for home; `has_homed` says when it is found, `finish_homing` is due then.

        The axis must be enabled and stand still. Raises `DriveError`, `BusError`.
        """
        self._homing_due_s = self._clock.now_s() + homing.timeout_s
        self.adjust(dict(_homing_settings(homing)))
        self.write(od.CONTROLWORD, ENABLE)
        # An attained bit left from an earlier homing is not believed until it has been seen to fall.
        self._attained_is_fresh = not self.statusword() & HOMING_ATTAINED or homing.method == HOMING_HERE
        self.write(od.CONTROLWORD, ENABLE | NEW_SETPOINT)

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
        self.wait_until_still(ANSWER_TIME_S)
        # Even a fresh bit can be wrong; that the counter has been set cannot be.
        position = self.position()
        if homing.method == HOMING_HERE and abs(position - homing.position) > STILL_COUNTS:
            raise DriveError(
                f"{self.name} reads {position} quadcounts after homing here, expected {homing.position}",
                _CHECK_POWER,
            )
        self.write(od.CONTROLWORD, ENABLE | HALT)
        self.write(od.TARGET_POSITION, position)
        self.ensure(od.MODE, _PROFILE_POSITION)

    def halt(self) -> None:
        """Decelerate and hold, if the axis is powered; power is never switched on by this."""
        if decode_state(self.statusword()) is DriveState.OPERATION_ENABLED:
            self.write(od.CONTROLWORD, ENABLE | HALT)

    def call_halt(self) -> None:
        """Tell a drive that was enabled when it was last heard to halt, and wait for nothing. Raises `BusError`."""
        if self._was_enabled:
            data = od.CONTROLWORD.pack(ENABLE | HALT)
            self._sdo.post(od.CONTROLWORD.index, od.CONTROLWORD.subindex, data)

    def quick_stop(self) -> None:
        """Stop with the quick stop deceleration and leave operation enabled."""
        self.go_to(Goal.QUICK_STOPPED)

    def wait_until_still(self, within_s: float) -> None:
        """Return once the axis stands still. Raises `DriveError` when it still moves after `within_s`."""
        for _ in self.looks_until_still(within_s):
            self._clock.sleep(LOOK_S)

    def looks_until_still(self, within_s: float) -> Iterator[None]:
        """Look at the position until all that were read in `still_time_s` lie within its dither.

        Ends once it stands still; until then the caller lets `LOOK_S` pass after each look.

        Raises
        ------
        DriveError
            When it still moves after `within_s`.
        """
        deadline_s = self._clock.now_s() + within_s
        seen = deque([self.position()], maxlen=self._looks_until_still)
        while len(seen) < self._looks_until_still or max(seen) - min(seen) > STILL_COUNTS:
            if self._clock.now_s() > deadline_s:
                raise DriveError(
                    f"{self.name} still moves {within_s:.1f} s after it was stopped "
                    f"({seen[0]} -> {seen[-1]} quadcounts)",
                    "press the emergency stop",
                )
            yield
            seen.append(self.position())

    # Faults

    def raise_if_faulted(self) -> None:
        """Raise what the drive reported by itself, or what its statusword says.

        Raises
        ------
        DriveError
            Names the error code, what it means and what to do.
        """
        self.raise_if_reported()
        self._refuse_fault(self.statusword())

    def raise_if_reported(self) -> None:
        """Raise a restart, an emergency or a silence that has been noticed; asks the drive nothing.

        Raises
        ------
        DriveRestartedError, DriveFaultError, DriveSilentError
        """
        if self._restarted:
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
        self.raise_if_reported()
        self._refuse_unless_enabled(statusword)

    def _refuse_unless_enabled(self, statusword: int) -> None:
        self._refuse_fault(statusword)
        state = decode_state(statusword)
        if state is not DriveState.OPERATION_ENABLED:
            raise DriveError(
                f"{self.name} is in {state.name} (statusword 0x{statusword:04X}), expected OPERATION_ENABLED",
                "open the rig again once the cause is known",
            )

    def _refuse_fault(self, statusword: int) -> None:
        if decode_state(statusword) in FAULTED:
            code = self.read(od.LAST_ERROR) & 0xFFFF if self.read(od.ERROR_COUNT) else 0
            raise self._fault(code, self.read(od.ERROR_REGISTER))

    def _fault(self, code: int, register: int) -> DriveFaultError:
        emergency = describe_emergency(code)
        return DriveFaultError(
            f"{self.name} is in fault: {emergency} (error register 0x{register:02X})",
            emergency.remedy,
            code=code,
            register=register,
            text=emergency.text,
        )

    def reported_fault(self) -> DriveFaultError | None:
        """Return the fault in which the drive is, as its statusword says; None when it is in none."""
        try:
            self._refuse_fault(self.read(od.STATUSWORD))
        except DriveFaultError as fault:
            return fault
        return None

    def reset_fault(self) -> None:
        """Reset a fault, as a person has confirmed; power stays off and nothing moves.

        Raises
        ------
        DriveFaultError
            When the cause is still there.
        """
        fault = self.reported_fault()
        if fault is None:
            return
        if fault.code in _RESET_COMMUNICATION_FIRST:
            self.send_nmt(_NMT_RESET_COMMUNICATION)
            self._clock.sleep(ANSWER_TIME_S)
            self._restarted = False
            self.send_nmt(_NMT_START)
        self.write(od.CONTROLWORD, 0)
        self.write(od.CONTROLWORD, FAULT_RESET)
        self._clock.sleep(_RESET_TIME_S)
        self.write(od.CONTROLWORD, 0)
        self._emergency = None
        left = self.reported_fault()
        if left is not None:
            raise left.reworded(f"{left.message}; it could not be reset, its cause is still there")

    def _on_heartbeat(self, _can_id: int, data: bytearray, _timestamp: float) -> None:
        self._heard_s = self._clock.now_s()
        if data[:1] == b"\0":
            self._restarted = True

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
                    "look at its status in EPOS Studio",
                )
            self._clock.sleep(POLL_S)


def _homing_settings(homing: Homing) -> Iterable[tuple[od.Entry, int]]:
    yield od.MODE, _HOMING
    yield od.HOMING_METHOD, homing.method
    yield od.HOME_OFFSET, homing.offset
    yield od.HOME_POSITION, homing.position
    if homing.method != HOMING_HERE:
        yield od.HOMING_SPEED_SWITCH, homing.switch_rpm
        yield od.HOMING_SPEED_INDEX, homing.index_rpm
        yield od.HOMING_ACCELERATION, homing.rpm_per_s
    if homing.method in BY_CURRENT:
        yield od.CURRENT_THRESHOLD, homing.current_threshold_ma
