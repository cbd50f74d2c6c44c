"""A simulated CiA 402 drive: state machine, faults, homing and motion of one CANopen node."""

import math
from collections import deque
from collections.abc import Callable, Iterator
from functools import partial

from labrig.clock import Clock
from labrig.devices.axis_description import AxisDescription
from labrig.devices.drives import objects as co
from labrig.devices.drives.objects import Place
from labrig.devices.drives.states import (
    FAULT_RESET,
    HALT,
    HOMING_ATTAINED,
    NEW_SETPOINT,
    REMOTE,
    SETPOINT_ACKNOWLEDGED,
    TARGET_REACHED,
    DriveState,
)
from labrig.devices.simulated.bus import InProcessWire
from labrig.devices.simulated.dictionary import ObjectDictionary
from labrig.devices.simulated.node import CanopenNode, NmtState
from labrig.devices.simulated.shaft import Mechanics, MotorShaft, plan_search
from labrig.devices.simulated.states import POWERED, STATUS, STOPPING, obey
from labrig.devices.trapezoid import Limits

_REFERENCED = 0x8000
"""Bit of the statusword that a drive of maxon sets while it has its reference."""

_NMT_STATES = {0x01: NmtState.OPERATIONAL, 0x02: NmtState.STOPPED, 0x80: NmtState.PRE_OPERATIONAL}
"""NMT command -> the state to which it leads."""

_GENERIC, _FOLLOWING_ERROR, _HEARTBEAT_ERROR = 0x01, 0x8611, 0x8130
"""The bit of the error register that every error sets, and codes of two errors."""

_FAULT_SIGNAL = 1
"""What 0x6007 makes of a lost heartbeat; with 0 the drive goes on."""

_UNDER_VOLTAGE = 0x3220
_POWER_OFF, _SLOW_DOWN = 0, 1
"""Values of 0x605E: power off at once, or after braking with the profile deceleration."""

_STAYS_IN_QUICK_STOP = 5
"""From this value of 0x605A on, power stays on at the end of a quick stop."""

_MODE_SPECIFIC = 0x2000
_NEGATIVE_SWITCH, _POSITIVE_SWITCH, _BOTH_SWITCHES = 0x0001, 0x0002, 0x0003
_SWITCH_MASK = Place(0x2071, 4)
"""Object of an EPOS2 that says which limit switches stop it; without it both do."""

_LIMIT_ERRORS = {"epos2": (0xFF06, 0xFF07, 0xFF09)}
_LIMIT_ERRORS_OF_EPOS4 = (0x8A80, 0x8A81, 0x8A82)
"""Error codes of the negative and positive limit switch, and of a passed software limit, by table of error codes."""

_DISABLING_ERRORS = frozenset(
    {0x1000, 0x2310, 0x3210, 0x3220, 0x4210, 0x5113, 0x6100, 0x6320, 0x7320}
    | {0xFF01, 0xFF02, 0xFF03, 0xFF04, 0xFF0A, 0xFF0B}
)
"""Errors that switch the power stage off at once; to all others a drive reacts as 0x605E says (maxon's firmware
specification of the first EPOS generation, 798675-03)."""

_KEPT_EVENTS = 10_000


class SimulatedCia402Drive(CanopenNode):
    """One node.

    Parameters
    ----------
    section : AxisDescription
        Section of its axis in the rig file; complete. It tells the product, its units and its encoder.
    wire : InProcessWire
        The bus that it stands on; it says so with a boot-up frame.
    clock : Clock
        Whose time it moves in. `tick` is to be called whenever that time advances.
    mechanics : Mechanics
        What the shaft can run against.
    boot_time_s : float
        How long it is silent after a reset.

    Attributes
    ----------
    shaft : MotorShaft
        Its motor shaft.
    journal : deque of (float, str)
        What it did last, oldest first: the exact instant [s], not that of the tick that noticed it, and boot,
        set-point, homing, brake, or emergency with the error code.
    """

    def __init__(
        self,
        section: AxisDescription,
        wire: InProcessWire,
        clock: Clock,
        mechanics: Mechanics,
        *,
        boot_time_s: float = 0.0,
    ) -> None:
        self.section, self._model = section, section.model()
        self._limit_errors = _LIMIT_ERRORS.get(self._model.errors, _LIMIT_ERRORS_OF_EPOS4)
        self._scale = section.scale()
        self.journal: deque[tuple[float, str]] = deque(maxlen=_KEPT_EVENTS)
        self._forced_inputs = 0
        self._analog_mv = dict.fromkeys(self._model.analog, 0)
        self._lasting_errors: set[int] = set()
        self._boot_time_s = boot_time_s
        self._ready_s = clock.now_s()
        self.shaft = MotorShaft(mechanics, clock.now_s())
        self._inputs = 0
        self._done_s = -math.inf
        self._forget()
        objects = ObjectDictionary(
            self._model, section.node_id, self._list_fixed_objects(), self._list_live_objects()
        )
        self._values = objects.value
        super().__init__(wire, section.node_id, clock, objects)
        self._note("boot")
        self.boot()

    def _forget(self) -> None:
        """Be as after power on."""
        self._state = DriveState.SWITCH_ON_DISABLED
        self._errors: list[int] = []
        self._target = 0.0
        self._homing: Iterator[None] | None = None
        self._seeks_stop = self._attained = self._homing_failed = self._referenced = False
        self._acknowledged = False

    @property
    def shaft_counts(self) -> float:
        """Where the motor's shaft stands, whatever the counter has been set to."""
        return self.shaft.position

    @property
    def is_moving(self) -> bool:
        """Whether a profile is under way."""
        return not self.shaft.is_at_rest(self._clock.now_s())

    @property
    def is_homing(self) -> bool:
        """Whether homing is under way."""
        return self._homing is not None

    def is_powered(self) -> bool:
        """Tell whether the power stage is on."""
        return self._state in POWERED

    # What its product decides

    def _position_limits(self) -> tuple[float, float]:
        low, high = self.objects.values[co.LOWER_LIMIT], self.objects.values[co.UPPER_LIMIT]
        return (low, high) if low or high else (-math.inf, math.inf)

    def _current_limit_ma(self) -> float:
        """Return the output current limit [mA]; none by default."""
        if self._model.current_limit_ma is not None:
            return float(self._values(self._model.current_limit_ma))
        values = self.objects.values
        rated_ma = values.get(co.RATED_CURRENT, 0)
        return values.get(co.MAX_CURRENT, 0) * rated_ma / 1000 if rated_ma else math.inf

    def lose_master(self, t_s: float) -> None:
        """Do what the abort connection option code says when the heartbeat of the computer has ended."""
        if self._values(co.ABORT_CONNECTION) == _FAULT_SIGNAL:
            self._raise_error(_HEARTBEAT_ERROR, t_s)

    # What tests and fault scripts do to it

    def fail(self, code: int) -> None:
        """Go to fault with an error code: tell it by EMCY, and brake or lose power as the code has it."""
        self._raise_error(code, self._clock.now_s())

    def cut_power_stage(self) -> None:
        """Take the supply of the power stage away, as an emergency stop does; the fault stays until it is back."""
        self._lasting_errors.add(_UNDER_VOLTAGE)
        self.fail(_UNDER_VOLTAGE)

    def restore_power_stage(self) -> None:
        """Give the power stage its supply back."""
        self._lasting_errors.clear()

    def set_input(self, name: str, value: float) -> None:
        """Put an analog input at a voltage [mV], or switch a digital input on (not 0) or off (0)."""
        bit = self.section.digital_inputs.get(name)
        if bit is None:
            self._analog_mv[name] = round(value)
            return
        self._forced_inputs = self._forced_inputs & ~(1 << bit) | bool(value) << bit
        self._done_s = -math.inf
        self.tick()

    def restart(self) -> None:
        """Lose power and come back: settings, reference and counter are lost, the shaft stays where it is."""
        now_s = self._clock.now_s()
        self.shaft.hold(now_s)
        self.shaft.count_from(now_s, 0.0)
        self._forget()
        self.objects.load()
        self.nmt_state = NmtState.OFF
        self._ready_s = now_s + self._boot_time_s
        self._note("boot")
        if not self._boot_time_s:
            self.boot()

    # Time

    def tick(self) -> None:
        """Do what has become due by now; nothing does twice at one instant, unless something has been changed."""
        now_s, seeks_switch = self._clock.now_s(), self.is_homing
        if now_s == self._done_s:
            return
        self._done_s = now_s
        if self.nmt_state is NmtState.OFF and now_s >= self._ready_s:
            self.boot()
        if self._state is DriveState.OPERATION_ENABLED or self._state is DriveState.QUICK_STOP_ACTIVE:
            self._watch(now_s)
        self.shaft.tick(now_s)
        if self._homing is not None and next(self._homing, self) is self:
            self._homing = None
        if self._state in STOPPING and not self.is_moving:
            self._end_stop()
        self._read_switches(seeks_switch=seeks_switch)
        self.send_due(now_s)

    def _end_stop(self) -> None:
        if self._state is DriveState.FAULT_REACTION:
            self._state = DriveState.FAULT
            self._hold()
        elif self.objects.values.get(co.QUICK_STOP_OPTION, _STAYS_IN_QUICK_STOP) < _STAYS_IN_QUICK_STOP:
            self._change_state(0)

    def _watch(self, now_s: float) -> None:
        """Notice software limits and following error, at the instant at which they were passed."""
        low, high = self._position_limits()
        is_guarded = self._model.has(co.MAX_FOLLOWING_ERROR) and not self._seeks_stop
        window = self._values(co.MAX_FOLLOWING_ERROR) if is_guarded else math.inf
        demand, actual = self.shaft.at(now_s)
        if not (low <= demand <= high and low <= actual <= high):
            code = self._limit_errors[2]
            passed_s = self.shaft.find_first_time(
                lambda d, a: not (low <= d <= high and low <= a <= high), now_s
            )
            self._raise_error(code, passed_s)
        elif abs(demand - actual) > window:
            self._raise_error(
                _FOLLOWING_ERROR, self.shaft.find_first_time(lambda d, a: abs(d - a) > window, now_s)
            )

    def _read_switches(self, *, seeks_switch: bool) -> None:
        before, self._inputs = self._inputs, self._read_inputs()
        pressed = self._inputs & ~before
        if not pressed or seeks_switch or self._state not in POWERED:
            return
        stops = self._values(_SWITCH_MASK) if self._model.has(_SWITCH_MASK) else _BOTH_SWITCHES
        for bit, code in zip((_NEGATIVE_SWITCH, _POSITIVE_SWITCH), self._limit_errors, strict=False):
            if pressed & stops & bit:
                self.fail(code)

    def _read_inputs(self) -> int:
        mechanics, place, word = self.shaft.mechanics, self.shaft.position, self._forced_inputs
        if mechanics.negative_switch is not None and place <= mechanics.negative_switch:
            word |= _NEGATIVE_SWITCH
        if mechanics.positive_switch is not None and place >= mechanics.positive_switch:
            word |= _POSITIVE_SWITCH
        return word

    def _read_masked_inputs(self) -> int:
        mask = self._model.input_mask
        return self._read_inputs() & (-1 if mask is None else self._values(mask))

    def _read_current_ma(self) -> float:
        """Return the motor current [mA]; 0 without power."""
        if not self.is_powered():
            return 0.0
        return self.shaft.current_ma(self._scale.counts_per_turn, self._current_limit_ma())

    def _read_current_per_mille(self) -> int:
        """Return the motor current in thousandths of the rated one, or in mA; the torque has the same number."""
        rated_ma = self.objects.values.get(co.RATED_CURRENT, 0)
        return round(self._read_current_ma() * (1000 / rated_ma if rated_ma else 1))

    def _note(self, what: str, t_s: float | None = None) -> None:
        self.journal.append((self._clock.now_s() if t_s is None else t_s, what))

    # Objects

    def _list_fixed_objects(self) -> dict[Place, int]:
        """Return what this drive is, whatever the defaults of its EDS file."""
        eds = self._model.eds
        return {
            co.DEVICE_TYPE: 0x00020192,
            co.VENDOR_ID: eds.vendor,
            co.PRODUCT_CODE: next(iter(self._model.types), eds.product),
            co.REVISION: eds.revision or 0,
            co.SERIAL_NUMBER: 1000 + self.section.node_id,
            **{stated.place: stated.raw for stated in self._model.stated if stated.raw is not None},
        }

    def _list_live_objects(self) -> dict[Place, Callable[[], int]]:
        """Return the objects whose value is made when it is read."""
        model = self._model
        live: dict[Place | None, Callable[[], int]] = {
            co.STATUSWORD: self._statusword,
            co.POSITION_ACTUAL: lambda: round(self.shaft.actual),
            co.MODE_DISPLAY: lambda: self._values(co.MODE),
            co.ERROR_CODE: lambda: self._errors[-1] if self._errors else 0,
            co.CURRENT_ACTUAL: self._read_current_per_mille,
            co.TORQUE_ACTUAL: self._read_current_per_mille,
            model.current_ma: lambda: round(self._read_current_ma()),
            model.following_error: lambda: round(self.shaft.demand - self.shaft.actual),
            model.inputs: self._read_masked_inputs,
            **{place: partial(self._analog_mv.__getitem__, name) for name, place in model.analog.items()},
        }
        return {place: read for place, read in live.items() if place is not None}

    def _on_write(self, place: Place, value: int, before: int) -> None:
        super()._on_write(place, value, before)
        self._done_s = -math.inf
        if place == co.CONTROLWORD:
            self._obey(value, before)
        elif place == co.MODE and value != before:
            self._change_mode()
        elif place == co.ERROR_COUNT:
            self.objects.values[co.LAST_ERROR] = 0

    def _change_mode(self) -> None:
        self._acknowledged = False
        self._stop_homing()
        if self.is_moving and self._state is DriveState.OPERATION_ENABLED:
            self._brake(co.PROFILE_DECELERATION, self._clock.now_s())

    # NMT

    def _obey_nmt(self, command: int) -> None:
        self.nmt_state = _NMT_STATES.get(command, self.nmt_state)
        if command == 0x81:
            self.restart()
        elif command == 0x82:
            first = self._model.reset_communication_first
            self._errors = [code for code in self._errors if code not in first]
            self.objects.load(only_communication=True)
            self.boot()

    # State machine

    def _statusword(self) -> int:
        word = STATUS[self._state]
        word |= REMOTE if self.nmt_state is NmtState.OPERATIONAL else 0
        word |= _REFERENCED if self._referenced else 0
        word |= TARGET_REACHED if self._has_arrived() else 0
        if self._values(co.MODE) == co.HOMING:
            word |= HOMING_ATTAINED if self._attained else 0
            return word | (_MODE_SPECIFIC if self._homing_failed else 0)
        word |= _MODE_SPECIFIC if _FOLLOWING_ERROR in self._errors else 0
        return word | (SETPOINT_ACKNOWLEDGED if self._acknowledged else 0)

    def _has_arrived(self) -> bool:
        """Tell bit 10: the profile is over, and inside the window if there is one for as long as its time."""
        now_s, due_s = self._clock.now_s(), self.shaft.profile.end_s
        if self.is_homing or self._homing_failed:
            return False
        window = self.objects.values.get(co.POSITION_WINDOW, co.WINDOW_OFF)
        if window != co.WINDOW_OFF:
            if abs(self.shaft.demand - self.shaft.actual) > window:
                return False
            due_s += self._values(co.POSITION_WINDOW_TIME) / 1000
        return now_s >= due_s

    def _obey(self, word: int, before: int) -> None:
        if self._state is DriveState.FAULT:
            if word & ~before & FAULT_RESET:
                self._reset_fault()
            return
        if self._state is not DriveState.FAULT_REACTION:
            self._change_state(word)
        if self._state is DriveState.OPERATION_ENABLED:
            if self._values(co.MODE) == co.HOMING:
                self._obey_homing_mode(word, before)
            else:
                self._obey_position_mode(word, before)

    def _change_state(self, word: int) -> None:
        """Make the transition that a controlword asks for; without power the axis stands where it is."""
        before, self._state = self._state, obey(self._state, word)
        if self._state is DriveState.QUICK_STOP_ACTIVE is not before:
            self._stop_homing()
            self._brake(co.QUICK_STOP_DECELERATION, self._clock.now_s())
        elif (before in POWERED) != self.is_powered():
            self._hold()

    def _hold(self) -> None:
        """Stand still: power has come or gone."""
        self._stop_homing()
        self._acknowledged = False
        self.shaft.hold(self._clock.now_s())

    # Modes

    def _obey_position_mode(self, word: int, before: int) -> None:
        if not word & NEW_SETPOINT:
            self._acknowledged = False
        elif not before & NEW_SETPOINT:
            self._target, self._acknowledged = float(self._values(co.TARGET_POSITION)), True
            self._note("set-point")
            if not word & HALT:
                self._start_move(self._clock.now_s())
        if word & HALT and not before & HALT:
            self._brake(co.PROFILE_DECELERATION, self._clock.now_s())
        elif before & HALT and not word & HALT:
            self._start_move(self._clock.now_s())

    def _obey_homing_mode(self, word: int, before: int) -> None:
        if word & HALT:
            if self.is_homing:
                self._stop_homing()
                self._brake(co.HOMING_ACCELERATION, self._clock.now_s())
        elif word & ~before & NEW_SETPOINT:
            method = self._values(co.HOMING_METHOD)
            self._attained = self._homing_failed = False
            self._note("homing")
            self._homing = self._home(method)
            self.tick()

    def _home(self, method: int) -> Iterator[None]:
        """Make the moves of a homing, and count from where they end; a turn for each tick."""
        start_s = self._clock.now_s()
        moves = plan_search(
            method, self.shaft, self._scale.counts_per_turn, self._read(self._model.home_offset)
        )
        for number, target in enumerate(moves):
            self._seeks_stop = method < 0 and number == 0
            speed = co.HOMING_SPEED_INDEX if number else co.HOMING_SPEED_SWITCH
            self.shaft.go(start_s, target, self._read_limits(speed, co.HOMING_ACCELERATION))
            self.shaft.tick(self._clock.now_s())
            while self.is_moving and not (self._seeks_stop and self.shaft.stuck):
                yield
            if self.is_moving:
                self.shaft.hold(self._clock.now_s())
            start_s = self.shaft.profile.end_s
        self._seeks_stop = False
        self.shaft.count_from(self._clock.now_s(), float(self._read(self._model.home_position)))
        self._target = self.shaft.actual
        self._attained = self._referenced = True

    def _read(self, place: Place | None) -> int:
        """Return the value of an object that the product may lack."""
        return 0 if place is None else self._values(place)

    def _stop_homing(self) -> None:
        self._homing, self._seeks_stop = None, False

    # Motion

    def _read_limits(self, speed: Place, acceleration: Place | None = None) -> Limits:
        highest = self._values(co.MAX_ACCELERATION)
        up = min(highest, self._values(acceleration or co.PROFILE_ACCELERATION))
        down = min(highest, self._values(acceleration or co.PROFILE_DECELERATION))
        speed_units = min(self._values(speed), self._values(co.MAX_PROFILE_VELOCITY))
        counts = self._scale.counts_per_turn / self._scale.speed_units
        return Limits(speed_units * counts, self._to_counts(up), self._to_counts(down))

    def _to_counts(self, acceleration: int) -> float:
        """Return an acceleration in counts/s^2."""
        return acceleration * self._scale.counts_per_turn / self._scale.acceleration_units

    def _start_move(self, t_s: float) -> None:
        self.shaft.go(t_s, self._target, self._read_limits(co.PROFILE_VELOCITY))

    def _brake(self, place: Place, t_s: float) -> None:
        if self.is_moving:
            self._note("brake", t_s)
        self.shaft.brake(t_s, self._to_counts(self._values(place)))

    # Faults

    def _raise_error(self, code: int, t_s: float) -> None:
        if code in self._errors:
            return
        self._errors.append(code)
        values = self.objects.values
        values |= {co.LAST_ERROR: code, co.ERROR_COUNT: 1, co.ERROR_REGISTER: _GENERIC}
        self._note(f"emergency 0x{code:04X}", t_s)
        self._react(code, t_s)
        self.send_emergency(code, _GENERIC)

    def _react(self, code: int, t_s: float) -> None:
        """Brake, or switch the power stage off at once, whichever the error and 0x605E ask for."""
        option = self._values(co.FAULT_REACTION)
        self._homing_failed = self._homing_failed or self.is_homing
        self._stop_homing()
        loses_power = option == _POWER_OFF or code in _DISABLING_ERRORS | self._lasting_errors
        if loses_power or not self.is_powered():
            self._hold()
            self._state = DriveState.FAULT
        elif self._state is not DriveState.FAULT_REACTION:
            self._brake(co.PROFILE_DECELERATION if option == _SLOW_DOWN else co.QUICK_STOP_DECELERATION, t_s)
            self._state = DriveState.FAULT_REACTION

    def _reset_fault(self) -> None:
        kept = self._model.reset_communication_first | self._lasting_errors
        self._errors = [code for code in self._errors if code in kept]
        if not self._errors:
            self._state = DriveState.SWITCH_ON_DISABLED
            self.objects.values[co.ERROR_REGISTER] = 0
            self.send_emergency(0, 0)
