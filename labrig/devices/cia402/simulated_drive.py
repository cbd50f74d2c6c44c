"""A simulated CiA 402 drive: the objects of its EDS file; state machine and motion are those of the profile."""

import math
from collections.abc import Callable, Mapping
from functools import partial

from labrig.clock import Clock
from labrig.devices import canopen_objects as co
from labrig.devices.canopen_objects import Entry
from labrig.devices.cia402 import objects as od
from labrig.devices.cia402.error_codes import describe_emergency
from labrig.devices.cia402.settings import ANALOG_KEYS, Cia402Axis
from labrig.devices.cia402.units import ACCELERATION_CODES, VELOCITY_CODES, write_unit
from labrig.devices.cia402_states import DriveState
from labrig.devices.simulated.bus import InProcessWire
from labrig.devices.simulated.cia402_node import SimulatedCia402Drive
from labrig.devices.simulated.dictionary import ObjectTable
from labrig.devices.simulated.shaft import Mechanics

_STAYS_IN_QUICK_STOP = 5
"""From this value of 0x605A on, power stays on at the end of a quick stop."""

_LIMIT_SWITCHES = 0x0003
_NO_FOLLOWING_ERROR = 0xFFFFFFFF
_NO_LIMITS = (-(2**31), 2**31 - 1)
_MODES = 0x25
"""0x6502: profile position, profile velocity, homing."""


class SimulatedProfileDrive(SimulatedCia402Drive):
    """One CiA 402 drive.

    Parameters
    ----------
    section : Cia402Axis
        Its section of the rig file; complete.
    wire, clock, mechanics, boot_time_s
        See `SimulatedCia402Drive`.
    """

    def __init__(
        self,
        section: Cia402Axis,
        wire: InProcessWire,
        clock: Clock,
        mechanics: Mechanics,
        boot_time_s: float = 0.0,
    ) -> None:
        self._section = section
        self._scale = section.scale()
        self._counts_per_turn = round(self._scale.counts_per_turn)
        eds = section.read_eds()
        self._has = frozenset(eds.entries)
        fixed = {
            co.DEVICE_TYPE: co.DEVICE_TYPE.default,
            co.VENDOR_ID: eds.vendor,
            co.PRODUCT_CODE: eds.product,
            co.REVISION: eds.revision or 0,
            co.SERIAL_NUMBER: 1000 + section.node_id,
            co.SUPPORTED_MODES: _MODES,
            od.VELOCITY_UNIT: write_unit(section.velocity_unit, section.velocity_factor, VELOCITY_CODES),
            od.ACCELERATION_UNIT: write_unit(
                section.acceleration_unit, section.acceleration_factor, ACCELERATION_CODES
            ),
            section.objects.entry("counts_per_turn"): self._counts_per_turn,
            co.MAX_FOLLOWING_ERROR: None if co.MAX_FOLLOWING_ERROR in self._has else _NO_FOLLOWING_ERROR,
        }
        super().__init__(
            wire,
            section.node_id,
            clock,
            table=ObjectTable(eds.product_name.encode("ascii", "replace"), tuple(eds.entries.values())),
            fixed={entry: value for entry, value in fixed.items() if entry is not None and value is not None},
            mechanics=mechanics,
            boot_time_s=boot_time_s,
        )

    def _option(self, entry: Entry, default: int) -> int:
        """Return an option code; `default` for a drive without the object."""
        return self.objects.values.get(entry, default)

    def counts_per_turn(self) -> int:
        """Return the counts per turn of the motor."""
        return self._counts_per_turn

    def counts_per_speed_unit(self) -> float:
        """Return the counts per second at one unit of speed."""
        return self._counts_per_turn / self._scale.speed_units

    def counts_per_acceleration_unit(self) -> float:
        """Return the counts per second squared at one unit of acceleration."""
        return self._counts_per_turn / self._scale.acceleration_units

    def watched_switches(self) -> int:
        """Return both limit switches: an EPOS4 has its inputs set for them by default."""
        return _LIMIT_SWITCHES

    def home_counter(self) -> int:
        """Return the value of the object for it; zero in a drive without one."""
        return self._option(self._section.objects.entry("home_position") or co.HOME_OFFSET, 0)

    def stays_in_quick_stop(self) -> bool:
        """Tell it from the quick stop option code."""
        return self._option(od.QUICK_STOP_OPTION, 2) >= _STAYS_IN_QUICK_STOP

    def position_limits(self) -> tuple[int, int]:
        """Return the software limits; both zero, the default of an EPOS4, mean no limits."""
        limits = super().position_limits()
        return limits if any(limits) else _NO_LIMITS

    def error_register(self, code: int) -> int:
        """Return the bits that an error sets."""
        return describe_emergency(code).register

    def tick(self) -> None:
        """Do what is due; at the end of a quick stop, switch power off if its option code says so."""
        super().tick()
        if (
            self._state is DriveState.QUICK_STOP_ACTIVE
            and self._is_at_rest()
            and not self.stays_in_quick_stop()
        ):
            self._change_state(0)

    def add_twin(self) -> None:
        """Put another drive with the same node id on the bus."""
        SimulatedProfileDrive(self._section, self._wire, self._clock, self._shaft.mechanics)

    def set_encoder(self, pulses: int) -> None:
        """Change the encoder resolution, as if somebody had changed the settings."""
        self._counts_per_turn = 4 * pulses
        entry = self._section.objects.entry("counts_per_turn")
        if entry is not None:
            self.objects.set_fixed(entry, self._counts_per_turn)

    def live_objects(self) -> dict[Entry, Callable[[], int]]:
        """Return the objects whose value is computed when it is read."""
        objects = self._section.objects
        of_maker: dict[Entry | None, Callable[[], int]] = {
            objects.entry("current_ma"): lambda: round(self.read_current_ma()),
            **{objects.entry(key): partial(self.read_analog_mv, name) for name, key in ANALOG_KEYS.items()},
        }
        return (
            super().live_objects()
            | {
                od.ERROR_CODE: lambda: self._errors[-1] if self._errors else 0,
                od.DIGITAL_INPUTS: self._read_inputs,
                od.FOLLOWING_ERROR: self.read_lag,
                co.CURRENT_ACTUAL: self._read_current_per_mille,
                od.TORQUE_ACTUAL: self._read_current_per_mille,
            }
            | {entry: read for entry, read in of_maker.items() if entry is not None}
        )

    def _read_current_per_mille(self) -> int:
        """Return the motor current in thousandths of the rated one; the torque has the same number."""
        rated_ma = self._option(od.RATED_CURRENT, 0)
        return round(1000 * self.read_current_ma() / rated_ma) if rated_ma else 0

    def digital_inputs(self) -> Mapping[str, int]:
        """Return the digital inputs by name -> bit of 0x60FD."""
        return self._section.digital_inputs

    def current_limit_ma(self) -> float:
        """Return the output current limit [mA]: the object that its section names, or 0x6073; none without either."""
        named = self._section.objects.entry("current_limit_ma")
        if named is not None:
            return float(self._option(named, 0))
        rated_ma = self._option(od.RATED_CURRENT, 0)
        return self._option(od.MAX_CURRENT, 0) * rated_ma / 1000 if rated_ma else math.inf
