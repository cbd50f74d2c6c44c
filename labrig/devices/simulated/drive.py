"""A simulated EPOS2: a CANopen node with object dictionary, state machine and motion."""

import struct
from collections.abc import Callable

import can

from labrig.clock import Clock
from labrig.devices import epos2_objects as od
from labrig.devices.cia402 import (
    CHANGE_IMMEDIATELY,
    FAULT_RESET,
    HALT,
    HOMING_ATTAINED,
    NEW_SETPOINT,
    REFERENCED,
    RELATIVE,
    REMOTE,
    SETPOINT_ACKNOWLEDGED,
    STATUSWORDS,
    TARGET_REACHED,
    DriveState,
)
from labrig.devices.epos2_errors import describe_emergency
from labrig.devices.simulated import sdo_server
from labrig.devices.simulated.bus import InProcessBus, InProcessWire
from labrig.devices.simulated.sdo_server import SdoAbortError, SdoServer
from labrig.devices.simulated.trapezoid import Limits, Profile, at_rest, braking, moving

_ENTRIES = {(entry.index, entry.subindex): entry for entry in od.NUMBERS}
_INDICES = {entry.index for entry in od.NUMBERS}
_STATE_BITS = {state: bits for bits, state in reversed(STATUSWORDS.items())}
_PROFILE_POSITION, _HOMING = 1, 6
_POWERED = frozenset({DriveState.OPERATION_ENABLED, DriveState.QUICK_STOP_ACTIVE, DriveState.FAULT_REACTION})
_POSITION_LIMIT_ERROR = 0xFF09
_CROSSING_HALVINGS = 40


class SimulatedDrive:
    """One node.

    Parameters
    ----------
    wire : InProcessWire
        The bus that it stands on; it says so with a boot-up frame.
    node_id : int
        Its node id.
    clock : Clock
        Whose time it moves in. `tick` is to be called whenever that time advances.
    encoder_pulses : int
        Lines of its encoder a turn.
    shaft_quadcounts : float
        Where the motor's shaft stands; the counter starts at zero whatever this is, as after power on.
    hardware_version : int
        What it says it is (0x2003:02).
    """

    def __init__(
        self,
        wire: InProcessWire,
        node_id: int,
        clock: Clock,
        *,
        encoder_pulses: int = 500,
        shaft_quadcounts: float = 0.0,
        hardware_version: int = od.HARDWARE_VERSION.default,
    ) -> None:
        self.node_id = node_id
        self._clock = clock
        self._settings = {
            od.ENCODER_PULSES: encoder_pulses,
            od.HARDWARE_VERSION: hardware_version,
            od.PRODUCT_CODE: hardware_version << 16,
            od.SERIAL_NUMBER: 1000 + node_id,
        }
        self._sdo = SdoServer(self._read, self._write)
        self._live: dict[od.Entry, Callable[[], int]] = {
            od.STATUSWORD: self._statusword,
            od.POSITION_ACTUAL: lambda: round(self._position),
            od.POSITION_DEMAND: lambda: round(self._position),
            od.MODE_DISPLAY: lambda: self._values[od.MODE],
        }
        self._handlers: dict[int, Callable[[bytes], None]] = {
            0x000: self._on_nmt,
            0x600 + node_id: self._on_sdo,
        }
        self._bus = InProcessBus(wire, self._on_frame)
        self._values: dict[od.Entry, int] = {}
        self._profile: Profile = at_rest(0.0, 0.0)
        self._position = self._velocity = self._counter_zero = self._ticked_s = 0.0
        self._state = DriveState.SWITCH_ON_DISABLED
        self._target = 0
        self._operational = self._nmt_stopped = False
        self._acknowledged = self._attained = self._referenced = False
        self._power_on(shaft_quadcounts)

    @property
    def shaft_quadcounts(self) -> float:
        """Where the motor's shaft stands, whatever the counter has been set to."""
        return self._position + self._counter_zero

    def tick(self) -> None:
        """Do what has become due by now."""
        now_s = self._clock.now_s()
        self._position, self._velocity = self._profile.at(now_s)
        if self._position < self._values[od.LOWER_LIMIT] or self._position > self._values[od.UPPER_LIMIT]:
            self._leave_limits(now_s)
        if self._state is DriveState.FAULT_REACTION and self._at_rest():
            self._state = DriveState.FAULT
        self._ticked_s = now_s

    def fail(self, code: int) -> None:
        """Go to fault with an error code: tell it by EMCY, brake, switch the power stage off."""
        self._raise_error(code, self._clock.now_s())

    def unplug(self) -> None:
        """Leave the bus without a word; what moves goes on moving."""
        self._bus.shutdown()

    def restart(self) -> None:
        """Lose power and come back: settings, reference and counter are lost, the shaft stays where it is."""
        self._power_on(self.shaft_quadcounts)

    # Frames

    def _send(self, can_id: int, data: bytes) -> None:
        self._bus.send(can.Message(arbitration_id=can_id, data=data, is_extended_id=False))

    def _on_frame(self, message: can.Message) -> None:
        handler = self._handlers.get(message.arbitration_id)
        if handler is not None:
            self.tick()
            handler(bytes(message.data))

    def _on_sdo(self, request: bytes) -> None:
        if self._nmt_stopped:
            return
        response = self._sdo.answer(request)
        if response is not None:
            self._send(0x580 + self.node_id, response)

    def _on_nmt(self, data: bytes) -> None:
        command, node_id = data[0], data[1]
        if node_id not in {0, self.node_id}:
            return
        if command in {0x81, 0x82}:
            self.restart()
            return
        self._operational, self._nmt_stopped = command == 0x01, command == 0x02

    # Object dictionary

    def _value(self, entry: od.Entry) -> int:
        live = self._live.get(entry)
        return self._values[entry] if live is None else live()

    def _read(self, index: int, subindex: int) -> bytes:
        if (index, subindex) == od.DEVICE_NAME:
            return b"EPOS2"
        entry = self._entry(index, subindex)
        return entry.pack(self._value(entry))

    def _write(self, index: int, subindex: int, data: bytes) -> None:
        entry = self._entry(index, subindex)
        if entry.access == "ro":
            raise SdoAbortError(sdo_server.READ_ONLY)
        if len(data) != entry.size:
            raise SdoAbortError(sdo_server.LENGTH)
        value = entry.unpack(data)
        if entry.lowest is not None and value < entry.lowest:
            raise SdoAbortError(sdo_server.TOO_LOW)
        if entry.highest is not None and value > entry.highest:
            raise SdoAbortError(sdo_server.TOO_HIGH)
        before, self._values[entry] = self._values[entry], value
        if entry is od.CONTROLWORD:
            self._obey(value, before)

    @staticmethod
    def _entry(index: int, subindex: int) -> od.Entry:
        entry = _ENTRIES.get((index, subindex))
        if entry is None:
            raise SdoAbortError(sdo_server.NO_SUBINDEX if index in _INDICES else sdo_server.NO_OBJECT)
        return entry

    def _power_on(self, shaft_quadcounts: float) -> None:
        self._values = {entry: entry.default for entry in od.NUMBERS} | self._settings
        self._state = DriveState.SWITCH_ON_DISABLED
        self._operational = self._nmt_stopped = False
        self._counter_zero = shaft_quadcounts
        self._position = self._velocity = 0.0
        self._ticked_s = self._clock.now_s()
        self._profile = at_rest(self._ticked_s, 0.0)
        self._target = 0
        self._acknowledged = self._attained = self._referenced = False
        self._send(0x700 + self.node_id, b"\0")

    # State machine

    def _statusword(self) -> int:
        word = _STATE_BITS[self._state]
        word |= REMOTE if self._operational else 0
        word |= REFERENCED if self._referenced else 0
        word |= TARGET_REACHED if self._arrived() else 0
        if self._values[od.MODE] == _HOMING:
            return word | (HOMING_ATTAINED if self._attained else 0)
        return word | (SETPOINT_ACKNOWLEDGED if self._acknowledged else 0)

    def _arrived(self) -> bool:
        """Tell bit 10: at rest, inside the window if there is one, for as long as the window time."""
        due_s = self._profile.end_s
        if self._values[od.POSITION_WINDOW] != od.WINDOW_OFF:
            due_s += self._values[od.POSITION_WINDOW_TIME] / 1000
        return self._clock.now_s() >= due_s

    def _at_rest(self) -> bool:
        return self._clock.now_s() >= self._profile.end_s

    def _obey(self, word: int, before: int) -> None:
        if self._state is DriveState.FAULT:
            if word & ~before & FAULT_RESET:
                self._reset_fault()
            return
        if self._state is not DriveState.FAULT_REACTION:
            self._change_state(word)
        if self._state is DriveState.OPERATION_ENABLED:
            self._operate(word, before)

    def _change_state(self, word: int) -> None:
        powered = self._state in _POWERED
        if not word & 0x02:
            self._state = DriveState.SWITCH_ON_DISABLED
        elif not word & 0x04:
            self._quick_stop()
        elif self._state is DriveState.QUICK_STOP_ACTIVE:
            return
        elif word & 0x0F in {0x06, 0x0E}:
            self._state = DriveState.READY_TO_SWITCH_ON
        elif self._state is not DriveState.SWITCH_ON_DISABLED:
            # Transitions 3 and 4 may be combined.
            enabled = word & 0x0F == 0x0F
            self._state = DriveState.OPERATION_ENABLED if enabled else DriveState.SWITCHED_ON
        if powered != (self._state in _POWERED):
            # Power has come or gone: the shaft holds still where it is.
            self._profile = at_rest(self._clock.now_s(), self._position)

    def _quick_stop(self) -> None:
        if self._state is DriveState.OPERATION_ENABLED:
            self._state = DriveState.QUICK_STOP_ACTIVE
            self._brake(od.QUICK_STOP_DECELERATION, self._clock.now_s())
        elif self._state is not DriveState.QUICK_STOP_ACTIVE:
            self._state = DriveState.SWITCH_ON_DISABLED

    def _operate(self, word: int, before: int) -> None:
        if self._values[od.MODE] == _HOMING:
            if word & ~before & NEW_SETPOINT and self._values[od.HOMING_METHOD] == 35:
                self._home_here()
        elif self._values[od.MODE] == _PROFILE_POSITION:
            self._position_mode(word, before)

    def _position_mode(self, word: int, before: int) -> None:
        if not word & NEW_SETPOINT:
            self._acknowledged = False
        elif not before & NEW_SETPOINT and (word & CHANGE_IMMEDIATELY or self._at_rest()):
            self._acknowledged = True
            start = round(self._position) if word & RELATIVE else 0
            self._target = start + self._values[od.TARGET_POSITION]
            if not word & HALT:
                self._go()
        if word & HALT and not before & HALT:
            self._brake(od.PROFILE_DECELERATION, self._clock.now_s())
        elif before & HALT and not word & HALT:
            self._go()

    # Motion

    def _counts_per_s(self, entry: od.Entry) -> float:
        """Return a setting in rpm or rpm/s as quadcounts a second or a second squared."""
        return self._values[entry] * 4 * self._values[od.ENCODER_PULSES] / 60

    def _go(self) -> None:
        self._profile = moving(
            self._clock.now_s(),
            self._position,
            self._velocity,
            self._target,
            Limits(
                min(self._counts_per_s(od.PROFILE_VELOCITY), self._counts_per_s(od.MAX_PROFILE_VELOCITY)),
                self._counts_per_s(od.PROFILE_ACCELERATION),
                self._counts_per_s(od.PROFILE_DECELERATION),
            ),
        )

    def _brake(self, entry: od.Entry, t_s: float) -> None:
        self._profile = braking(t_s, self._position, self._velocity, self._counts_per_s(entry))

    def _home_here(self) -> None:
        """Homing method 35: the counter here becomes the home position."""
        self._counter_zero = self.shaft_quadcounts - self._values[od.HOME_POSITION]
        self._position = float(self._values[od.HOME_POSITION])
        self._profile = at_rest(self._clock.now_s(), self._position)
        self._attained = self._referenced = True

    # Faults

    def _leave_limits(self, now_s: float) -> None:
        """Go to fault at the instant at which the limit was passed, and brake from there."""
        low, high = self._values[od.LOWER_LIMIT], self._values[od.UPPER_LIMIT]
        if self._state is not DriveState.OPERATION_ENABLED:
            return
        inside_s, outside_s = self._ticked_s, now_s
        for _ in range(_CROSSING_HALVINGS):
            middle_s = (inside_s + outside_s) / 2
            if low <= self._profile.at(middle_s)[0] <= high:
                inside_s = middle_s
            else:
                outside_s = middle_s
        self._position, self._velocity = self._profile.at(outside_s)
        self._raise_error(_POSITION_LIMIT_ERROR, outside_s)
        self._position, self._velocity = self._profile.at(now_s)

    def _raise_error(self, code: int, t_s: float) -> None:
        emergency = describe_emergency(code)
        if self._state in _POWERED:
            self._brake(od.QUICK_STOP_DECELERATION, t_s)
            self._state = DriveState.FAULT_REACTION
        else:
            self._state = DriveState.FAULT
        self._values[od.LAST_ERROR] = code
        self._values[od.ERROR_COUNT] = 1
        self._values[od.ERROR_REGISTER] = emergency.register | 0x01
        self._send(0x080 + self.node_id, struct.pack("<HB5x", code, emergency.register | 0x01))

    def _reset_fault(self) -> None:
        self._state = DriveState.SWITCH_ON_DISABLED
        self._values[od.ERROR_REGISTER] = 0
        self._send(0x080 + self.node_id, bytes(8))
