"""The driver of one EPOS2 (maxon) over CANopen, in quadcounts and rpm.

What is decided here
--------------------
- SDO only, through `canopen.RemoteNode`; its `BaseNode402` is not used, because it resets faults, enables
  power and reads signs of homing methods by itself, wrongly for maxon.
- Nothing is believed that has not been read back: each setting after writing, the set-point acknowledge with
  both edges, the position at the end of a move, standing still after a stop.
- A fault is never reset and power is never switched on but by `enable`, which holds Halt and has the actual
  position as target, so that nothing moves until a move is commanded.
- Only settings that differ are written, because writing clears the drive's configuration fingerprint
  (0x1020).
- Unsure until tried on a device: that 0x2210:01 holds the encoder resolution on every EPOS2, and that the
  measure init state may show bit 14.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import can
import canopen
from canopen.sdo.exceptions import SdoAbortedError, SdoCommunicationError

from labrig.clock import Clock
from labrig.devices import epos2_objects as od
from labrig.devices.bus import CanLink
from labrig.devices.cia402 import (
    CHANGE_IMMEDIATELY,
    ENABLE,
    FAULTED,
    HALT,
    HOMING_ATTAINED,
    HOMING_ERROR,
    NEW_SETPOINT,
    REFERENCED,
    SETPOINT_ACKNOWLEDGED,
    DriveState,
    Goal,
    decode_state,
    plan_controlword,
)
from labrig.devices.epos2_errors import describe_abort, describe_emergency
from labrig.errors import BusError, DriveError

POLL_S = 0.005
ANSWER_TIME_S = 1.0
"""Rig time within which a drive attains a state, acknowledges a set-point or finishes homing on the spot."""

STILL_COUNTS = 2
STILL_TIME_S = 0.05
"""An axis stands still when it moves no more than this in this time; a servo at rest dithers a little."""

_PROFILE_POSITION, _HOMING, _HERE = 1, 6, 35
_NMT_START = 0x01
_CHECK_POWER = "check power, CAN wiring, bit rate and node id of the drive"


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
    """

    def __init__(self, link: CanLink, node_id: int, name: str, clock: Clock) -> None:
        self.name = f"drive of axis {name} (node {node_id})"
        self.node_id = node_id
        self._clock = clock
        self._link = link
        # Objects are named by `epos2_objects`; canopen needs no dictionary of its own, and maxon's file fails
        # in it.
        self._node = canopen.RemoteNode(node_id, canopen.ObjectDictionary())  # type: ignore[no-untyped-call]
        link.network.add_node(self._node)
        self._node.sdo.RESPONSE_TIMEOUT = link.response_timeout_s
        self._restarted = False
        link.network.subscribe(0x700 + node_id, self._on_heartbeat)

    # Objects

    def read(self, entry: od.Entry) -> int:
        """Return the value of an object.

        Raises
        ------
        DriveError
            When the drive is silent or refuses.
        BusError
        """
        return entry.unpack(self._upload(entry.index, entry.subindex, entry.name))

    def write(self, entry: od.Entry, value: int) -> None:
        """Write an object. Raises as `read`."""
        what = f"{entry.name} ({entry.place}) = {value}"
        try:
            self._node.sdo.download(entry.index, entry.subindex, entry.pack(value))
        except SdoAbortedError as error:
            raise self._refused(what, error) from error
        except SdoCommunicationError as error:
            raise self._silent(what) from error
        except (can.CanError, OSError) as error:
            raise BusError(
                f"the CAN bus took no frame: {error}", "check adapter, cable, power and bit rate"
            ) from error

    def _upload(self, index: int, subindex: int, name: str) -> bytes:
        try:
            return bytes(self._node.sdo.upload(index, subindex))
        except SdoAbortedError as error:
            raise self._refused(name, error) from error
        except SdoCommunicationError as error:
            raise self._silent(name) from error
        except (can.CanError, OSError) as error:
            raise BusError(
                f"the CAN bus took no frame: {error}", "check adapter, cable, power and bit rate"
            ) from error

    def _refused(self, what: str, error: SdoAbortedError) -> DriveError:
        return DriveError(
            f"{self.name} refused {what}: {describe_abort(error.code)} (SDO abort 0x{error.code:08X})",
            "check rig file and drive settings against each other",
        )

    def _silent(self, what: str) -> DriveError:
        return DriveError(
            f"{self.name} did not answer within {self._link.response_timeout_s:g} s ({what})", _CHECK_POWER
        )

    # Connecting

    def identify(self) -> Identity:
        """Return what the drive is.

        Raises
        ------
        DriveError
            When it is no EPOS2: other generations have other objects and signs.
        """
        vendor, device_type = self.read(od.VENDOR_ID), self.read(od.DEVICE_TYPE)
        if vendor != od.VENDOR_ID.default or device_type != od.DEVICE_TYPE.default:
            raise self._not_an_epos2(f"vendor 0x{vendor:X}, device type 0x{device_type:08X}")
        hardware = self.read(od.HARDWARE_VERSION)
        model = od.EPOS2_HARDWARE.get(hardware & 0xFFF0)
        if model is None:
            other = od.OTHER_HARDWARE.get(hardware & 0xFFF0, "unknown to labrig")
            raise self._not_an_epos2(f"hardware version 0x{hardware:04X}, {other}")
        return Identity(model, hardware, self.read(od.SOFTWARE_VERSION), self.read(od.SERIAL_NUMBER))

    def _not_an_epos2(self, found: str) -> DriveError:
        return DriveError(
            f"{self.name} is no EPOS2: {found}", "check the node id in the rig file and the drive itself"
        )

    def configure(self, encoder_pulses: int, settings: Mapping[od.Entry, int]) -> None:
        """Bring a drive that stands still and unpowered to known settings; nothing moves.

        Parameters
        ----------
        encoder_pulses : int
            What its encoder resolution must be; checked, never written.
        settings : mapping of Entry to int
            Written where they differ, and read back.

        Raises
        ------
        DriveError
        """
        self.send_nmt(_NMT_START)
        self.raise_if_faulted()
        self.halt()
        self.wait_until_still(ANSWER_TIME_S)
        self.go_to(Goal.POWER_OFF)
        found = self.read(od.ENCODER_PULSES)
        if found != encoder_pulses:
            raise DriveError(
                f"{self.name} is set to {found} encoder pulses a turn, the rig file says {encoder_pulses}",
                "find out which encoder it has; correct the rig file, or the drive in EPOS Studio",
            )
        for entry, value in settings.items():
            self.ensure(entry, value)

    def ensure(self, entry: od.Entry, value: int) -> None:
        """Write an object where it differs, and read it back."""
        if self.read(entry) == value:
            return
        self.write(entry, value)
        found = self.read(entry)
        if found != value:
            raise DriveError(
                f"{self.name} kept {entry.name} ({entry.place}) at {found} when {value} was written",
                "check whether the drive's parameters are locked in EPOS Studio",
            )

    def send_nmt(self, command: int) -> None:
        """Send an NMT command to this node; NMT is not answered."""
        self._link.send(0x000, bytes([command, self.node_id]))

    # States

    def go_to(self, goal: Goal) -> None:
        """Bring the drive to a goal of its state machine.

        Raises
        ------
        DriveError
            On a fault when it is to be enabled, or when it does not get there.
        """
        deadline_s = self._clock.now_s() + ANSWER_TIME_S
        while True:
            statusword = self.read(od.STATUSWORD)
            if goal is Goal.ENABLED:
                self._refuse_fault(statusword)
            plan = plan_controlword(statusword, goal)
            if plan.attained:
                return
            if self._clock.now_s() > deadline_s:
                raise DriveError(
                    f"{self.name} stayed in {decode_state(statusword).name} for {ANSWER_TIME_S:g} s "
                    f"on the way to {goal.name} (statusword 0x{statusword:04X})",
                    "look at its status in EPOS Studio",
                )
            if plan.controlword is not None:
                self.write(od.CONTROLWORD, plan.controlword)
            self._clock.sleep(POLL_S)

    def enable(self) -> None:
        """Switch the power stage on; the axis holds where it is."""
        self.ensure(od.MODE, _PROFILE_POSITION)
        self.write(od.TARGET_POSITION, self.read(od.POSITION_ACTUAL))
        self.go_to(Goal.ENABLED)

    def position(self) -> int:
        """Return the actual position [quadcounts]."""
        return self.read(od.POSITION_ACTUAL)

    def statusword(self) -> int:
        """Return the statusword."""
        return self.read(od.STATUSWORD)

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
        self._refuse_unless_enabled(self.read(od.STATUSWORD))
        self.write(od.PROFILE_VELOCITY, rpm)
        self.write(od.TARGET_POSITION, target)
        self.write(od.CONTROLWORD, ENABLE | NEW_SETPOINT | CHANGE_IMMEDIATELY)
        self._wait_for_bit(SETPOINT_ACKNOWLEDGED, SETPOINT_ACKNOWLEDGED, "acknowledge the set-point")
        self.write(od.CONTROLWORD, ENABLE)
        self._wait_for_bit(SETPOINT_ACKNOWLEDGED, 0, "take back the acknowledge of the set-point")

    def home_here(self) -> None:
        """Make the position here zero (homing method 35); the axis must be enabled and standing still.

        Raises
        ------
        DriveError
        """
        for entry, value in (
            (od.MODE, _HOMING),
            (od.HOMING_METHOD, _HERE),
            (od.HOME_OFFSET, 0),
            (od.HOME_POSITION, 0),
        ):
            self.ensure(entry, value)
        self.write(od.CONTROLWORD, ENABLE)
        self._refuse_unless_enabled(self.read(od.STATUSWORD))
        self.write(od.CONTROLWORD, ENABLE | NEW_SETPOINT)
        self._wait_for_bit(HOMING_ATTAINED | HOMING_ERROR | REFERENCED, HOMING_ATTAINED | REFERENCED, "home")
        self.write(od.CONTROLWORD, ENABLE | HALT)
        # The attained bit may be a stale one; that the counter went to zero cannot be.
        position = self.position()
        if abs(position) > STILL_COUNTS:
            raise DriveError(
                f"{self.name} reads {position} quadcounts after homing here, expected 0", _CHECK_POWER
            )
        self.write(od.TARGET_POSITION, position)
        self.ensure(od.MODE, _PROFILE_POSITION)

    def halt(self) -> None:
        """Decelerate and hold, if the axis is powered; power is never switched on by this."""
        if decode_state(self.read(od.STATUSWORD)) is DriveState.OPERATION_ENABLED:
            self.write(od.CONTROLWORD, ENABLE | HALT)

    def quick_stop(self) -> None:
        """Stop with the quick stop deceleration and leave operation enabled."""
        self.go_to(Goal.QUICK_STOPPED)

    def wait_until_still(self, within_s: float) -> None:
        """Return once the axis stands still, as read from its position.

        Raises
        ------
        DriveError
            When it still moves after `within_s`.
        """
        deadline_s = self._clock.now_s() + within_s
        before = self.position()
        while True:
            self._clock.sleep(STILL_TIME_S)
            now = self.position()
            if abs(now - before) <= STILL_COUNTS:
                return
            if self._clock.now_s() > deadline_s:
                raise DriveError(
                    f"{self.name} still moves {within_s:.1f} s after it was stopped "
                    f"({before} -> {now} quadcounts)",
                    "press the emergency stop",
                )
            before = now

    # Faults

    def raise_if_faulted(self) -> None:
        """Raise what the drive reported by itself, or what its statusword says.

        Raises
        ------
        DriveError
            Names the error code, what it means and what to do.
        """
        self.raise_if_reported()
        self._refuse_fault(self.read(od.STATUSWORD))

    def raise_if_reported(self) -> None:
        """Raise an emergency or a restart that arrived since connecting; asks the drive nothing."""
        if self._node.emcy.active:
            raise self._fault(self._node.emcy.active[-1].code)
        if self._restarted:
            raise DriveError(
                f"{self.name} has restarted: it lost power, its position and its reference",
                "find out why it lost power; do not home while a needle is in tissue",
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
            raise self._fault(code)

    def _fault(self, code: int) -> DriveError:
        emergency = describe_emergency(code)
        return DriveError(f"{self.name} is in fault: {emergency}", emergency.remedy)

    def _on_heartbeat(self, _can_id: int, data: bytearray, _timestamp: float) -> None:
        if data[:1] == b"\0":
            self._restarted = True

    def _wait_for_bit(self, mask: int, wanted: int, what: str) -> None:
        deadline_s = self._clock.now_s() + ANSWER_TIME_S
        while True:
            statusword = self.read(od.STATUSWORD)
            if statusword & mask == wanted:
                return
            self.refuse_unless_enabled(statusword)
            if self._clock.now_s() > deadline_s:
                raise DriveError(
                    f"{self.name} did not {what} within {ANSWER_TIME_S:g} s (statusword 0x{statusword:04X})",
                    "look at its status in EPOS Studio",
                )
            self._clock.sleep(POLL_S)
