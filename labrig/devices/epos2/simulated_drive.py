"""A simulated EPOS2: its objects, errors and homing; state machine and motion are those of CiA 402."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import ClassVar

from labrig.clock import Clock
from labrig.devices import canopen_objects as co
from labrig.devices.canopen_objects import Entry
from labrig.devices.cia402_states import STATUSWORDS, DriveState
from labrig.devices.epos2 import objects as od
from labrig.devices.epos2.error_codes import describe_emergency
from labrig.devices.epos2.settings import ANALOG_INPUTS, Epos2Axis
from labrig.devices.simulated.bus import InProcessWire
from labrig.devices.simulated.cia402_node import SimulatedCia402Drive
from labrig.devices.simulated.dictionary import ObjectTable
from labrig.devices.simulated.shaft import Mechanics

METHODS = frozenset({-4, -3, -2, -1, 0, 1, 2, 7, 11, 17, 18, 23, 27, 33, 34, 35})
_SENSOR_ERROR = 0x7320
_DISABLING_ERRORS = frozenset(
    {0x1000, 0x2310, 0x3210, 0x3220, 0x4210, 0x5113, 0x6100, 0x6320, 0x7320}
    | {0xFF01, 0xFF02, 0xFF03, 0xFF04, 0xFF0A, 0xFF0B}
)
"""By maxon's firmware specification of the first EPOS generation (798675-03)."""

_NO_MECHANICS = Mechanics()
_EPOS2_70_10 = 0x6420
_RATED_MA = {_EPOS2_70_10: {od.CONTINUOUS_CURRENT: 10_000, od.MAX_CURRENT: 25_000}}
"""Hardware version -> current limits, default and highest at once; those of the table are an EPOS2 24/5's."""


def _objects(hardware_version: int) -> ObjectTable:
    """Return the objects of a type of EPOS2."""
    rated_ma = _RATED_MA.get(hardware_version & 0xFFF0, {})
    return ObjectTable(
        b"EPOS2",
        tuple(
            replace(entry, default=rated_ma[entry], highest=rated_ma[entry]) if entry in rated_ma else entry
            for entry in od.NUMBERS
        ),
        frozenset({od.ENCODER_PULSES, od.SENSOR_TYPE, od.SENSOR_POLARITY, co.MOTOR_TYPE, od.POLE_PAIRS}),
        (od.CONFIGURATION_DATE, od.CONFIGURATION_TIME),
    )


class SimulatedDrive(SimulatedCia402Drive):
    """One EPOS2.

    Parameters
    ----------
    wire, node_id, clock, shaft_counts, mechanics, boot_time_s
        See `SimulatedCia402Drive`.
    encoder_pulses : int
        Encoder lines per turn.
    hardware_version, software_version : int
        Versions that it reports (0x2003).
    """

    state_bits: ClassVar[Mapping[DriveState, int]] = {
        state: bits for bits, state in reversed(STATUSWORDS.items())
    }
    modes = frozenset({-6, -5, -3, -2, -1, 1, 3, 6, 7})
    homing_methods = METHODS
    switch_errors: ClassVar[Mapping[int, int]] = {0x0001: 0xFF06, 0x0002: 0xFF07}
    position_limit_error = 0xFF09
    disabling_errors = _DISABLING_ERRORS
    reset_communication_first = frozenset({0x8120, 0x81FD})
    reset_node_first = frozenset({0xFF04})

    def __init__(
        self,
        wire: InProcessWire,
        node_id: int,
        clock: Clock,
        *,
        encoder_pulses: int = 500,
        shaft_counts: float = 0.0,
        hardware_version: int = od.HARDWARE_VERSION.default,
        software_version: int = od.SOFTWARE_VERSION.default,
        mechanics: Mechanics = _NO_MECHANICS,
        boot_time_s: float = 0.0,
    ) -> None:
        super().__init__(
            wire,
            node_id,
            clock,
            table=_objects(hardware_version),
            fixed={
                od.NODE_ID: node_id,
                od.ENCODER_PULSES: encoder_pulses,
                od.HARDWARE_VERSION: hardware_version,
                od.SOFTWARE_VERSION: software_version,
                co.PRODUCT_CODE: hardware_version << 16,
                co.REVISION: software_version << 16,
                co.SERIAL_NUMBER: 1000 + node_id,
            },
            shaft_counts=shaft_counts,
            mechanics=mechanics,
            boot_time_s=boot_time_s,
        )

    def counts_per_turn(self) -> int:
        """Return four quadcounts per encoder line."""
        return 4 * self._values(od.ENCODER_PULSES)

    def watched_switches(self) -> int:
        """Return the limit switches that stop the drive by its execution mask."""
        return self._values(od.LIMIT_EXECUTION_MASK)

    def homing_offset(self) -> int:
        """Return the home offset, which is a distance here, not a position."""
        return self._values(co.HOME_OFFSET)

    def digital_inputs(self) -> Mapping[str, int]:
        """Return the digital inputs by name -> bit of 0x2071:01."""
        return Epos2Axis.digital_inputs

    def current_limit_ma(self) -> float:
        """Return the output current limit [mA]."""
        return float(self._values(od.MAX_CURRENT))

    def home_counter(self) -> int:
        """Return the home position."""
        return self._values(od.HOME_POSITION)

    def error_register(self, code: int) -> int:
        """Return the bits that an error sets."""
        return describe_emergency(code).register

    def add_twin(self) -> None:
        """Put another drive with the same node id on the bus."""
        SimulatedDrive(self._wire, self.node_id, self._clock, shaft_counts=self.shaft_counts)

    def set_encoder(self, pulses: int) -> None:
        """Change the encoder resolution, as if somebody had changed the settings."""
        self.objects.set_fixed(od.ENCODER_PULSES, pulses)

    def take_object(self, entry: Entry, value: int, before: int) -> None:
        """Lose the position if the encoder resolution is changed."""
        if entry == od.ENCODER_PULSES and value != before:
            self._referenced = False
            self.fail(_SENSOR_ERROR)

    def live_objects(self) -> dict[Entry, Callable[[], int]]:
        """Return the objects whose value is computed when it is read."""
        return super().live_objects() | {
            od.FOLLOWING_ERROR_ACTUAL: lambda: _clip_to_int16(self.read_lag()),
            co.CURRENT_ACTUAL: lambda: _clip_to_int16(self.read_current_ma()),
            od.CURRENT_AVERAGE: lambda: _clip_to_int16(self.read_current_ma()),
            **{entry: partial(self._read_analog, name) for name, entry in ANALOG_INPUTS.items()},
            od.ENCODER_COUNTER: lambda: round(self._shaft.actual) & 0xFFFFFFFF,
            od.INPUT_STATE: lambda: self._read_inputs() & self._values(od.INPUT_MASK),
            od.VELOCITY_AVERAGE: lambda: round(self.speed_quadcounts_s / self.counts_per_speed_unit()),
        }

    def _read_analog(self, name: str) -> int:
        return _clip_to_int16(self.read_analog_mv(name))


def _clip_to_int16(value: float) -> int:
    return max(-32768, min(32767, round(value)))
