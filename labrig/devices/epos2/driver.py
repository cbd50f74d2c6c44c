"""The driver of one EPOS2 (maxon).

What is decided here
--------------------
- Writing a setting clears the drive's configuration fingerprint (0x1020); the fingerprint is written again last.
- The encoder resolution is compared with the rig file and never written.
- An EPOS2 of an unknown type is refused with its hardware version, unless the rig file names this version: those of the
  24/2 and of others are not published. Its software version still has to be that of an EPOS2.
- Uncertain until tried on a device: whether 0x2210:01 holds the encoder resolution on every EPOS2; whether the measure
  init state may show bit 14; whether TxPDO 3 carries statusword and position by default and can be switched on while
  the node is operational (if not, SDO does all of it); which objects clear 0x1020 when they are written (it is written
  again after each one that labrig writes in operation); which function each bit of 0x2071:01 has; whether 0x6007 is 1
  as it comes, and can be written like the COB-IDs of the PDOs while the node is operational (if not, opening says which
  object to set and save in EPOS Studio).
- An EPOS2 has no quick stop option code 0x605A: its quick stop always brakes and holds.
"""

from collections.abc import Iterator, Mapping

from labrig.clock import Clock
from labrig.devices import canopen_objects as co
from labrig.devices.bus import CanLink
from labrig.devices.can_description import HeartbeatDescription
from labrig.devices.canopen_objects import Entry
from labrig.devices.cia402_drive import STOP_OPTIONS, Cia402Drive, still_time_s
from labrig.devices.cia402_states import DriveState, decode_state
from labrig.devices.drive import Homing, Identity, require_all
from labrig.devices.drive_reports import InputPlace
from labrig.devices.epos2 import objects as od
from labrig.devices.epos2.error_codes import describe_emergency
from labrig.devices.epos2.settings import (
    ANALOG_INPUTS,
    BY_CURRENT,
    HOMING_DIRECTIONS,
    Epos2Axis,
    drive_settings,
    fingerprint,
)
from labrig.devices.error_codes import Emergency
from labrig.devices.homing import HOMING_HERE
from labrig.errors import DriveError

UNKNOWN_MODEL = "EPOS2 of a type unknown to labrig"
"""Model of a drive that is accepted by the hardware version in the rig file."""

_SLOWEST_RPM = 1
_MILLIVOLT = 0.001


class Epos2(Cia402Drive[Epos2Axis]):
    """One EPOS2; its parameters are those of `Cia402Drive`."""

    tool = "EPOS Studio"
    reset_communication_first = frozenset({0x8120, 0x81FD})

    def __init__(self, link: CanLink, section: Epos2Axis, axis: str, clock: Clock) -> None:
        pulses = section.encoder_pulses_per_turn
        super().__init__(
            link,
            section,
            axis,
            clock,
            node_id=section.node_id,
            still_time_s=still_time_s(pulses and 4 * pulses * _SLOWEST_RPM / 60),
        )
        self._expected_fingerprint: tuple[int, int] | None = None

    def decode(self, statusword: int) -> DriveState:
        """Return the state that a statusword shows, including the states that maxon adds."""
        return decode_state(statusword)

    # Connecting

    def identify(self) -> Identity:
        """Return the identity of the drive after comparing its encoder and fingerprint with its section.

        Raises
        ------
        DriveError
            When it is no known EPOS2 (other generations have other objects and signs), when two drives answer, when it
            is set to another encoder, or when its configuration has been changed. An EPOS2 with other software is
            accepted: each setting is read back, and `labrig devices check` warns.
        """
        identity = self.read_identity()
        require_all((self.require_encoder, self.require_fingerprint))
        return identity

    def read_identity(self) -> Identity:
        """Return the identity of the drive, whatever its settings. Raises `DriveError` as `identify`."""
        vendor = self.wake()
        strays = self.sdo.strays
        device_type = self.upload(co.DEVICE_TYPE)
        if vendor != co.VENDOR_ID.default or device_type != co.DEVICE_TYPE.default:
            raise self._refuse_model(f"vendor 0x{vendor:X}, device type 0x{device_type:08X}")
        hardware = self.upload(od.HARDWARE_VERSION)
        model = self._name_model(hardware)
        software = self.upload(od.SOFTWARE_VERSION)
        if software not in od.EPOS2_SOFTWARE:
            low, high = od.EPOS2_SOFTWARE[0], od.EPOS2_SOFTWARE[-1]
            raise self._refuse_model(
                f"software version 0x{software:04X}, an EPOS2 has 0x{low:04X} to 0x{high:04X}"
            )
        versions = {"hardware_version": hardware, "software_version": software}
        identity = Identity(model, self.upload(co.SERIAL_NUMBER), versions)
        self.require_alone(strays)
        return identity

    def _name_model(self, hardware: int) -> str:
        """Return the name of the type by its hardware version. Raises `DriveError` for one that is not expected."""
        expected = self.section.hardware_version
        if expected is not None and hardware != expected:
            raise DriveError(
                f"{self.name} has hardware version 0x{hardware:04X}, the rig file says 0x{expected:04X}",
                "check the node id and hardware_version in the rig file, and the label of the drive",
            )
        kind = hardware & 0xFFF0
        if kind in od.OTHER_HARDWARE:
            raise self._refuse_model(f"hardware version 0x{hardware:04X}, {od.OTHER_HARDWARE[kind]}")
        model = od.EPOS2_HARDWARE.get(kind)
        if model is None and expected is None:
            raise self._refuse_model(
                f"hardware version 0x{hardware:04X}, unknown to labrig",
                f"; if its label says EPOS2, set hardware_version: 0x{hardware:04X} for this axis in the rig file",
            )
        return model or UNKNOWN_MODEL

    def _refuse_model(self, found: str, way_out: str = "") -> DriveError:
        known = ", ".join(f"{name} (0x{version:04X})" for version, name in od.EPOS2_HARDWARE.items())
        return DriveError(
            f"{self.name} is not an EPOS2 that labrig knows: {found}",
            f"check the node id in the rig file and the drive itself; known by 0x2003:02 are {known}{way_out}",
        )

    def require_encoder(self) -> None:
        """Refuse a drive whose encoder resolution differs from its section. Raises `DriveError`."""
        found, expected = self.upload(od.ENCODER_PULSES), self.section.encoder_pulses_per_turn
        if found != expected:
            raise DriveError(
                f"{self.name} is set to {found} encoder pulses a turn, the rig file says {expected}",
                "find out which encoder it has; correct the rig file, or the drive in EPOS Studio",
            )

    def require_fingerprint(self) -> None:
        """Refuse a drive whose fingerprint differs from the one in its section, if given. Raises `DriveError`."""
        expected = self.section.configuration_fingerprint
        if expected is None:
            return
        found = self.fingerprint()
        if found != expected:
            raise DriveError(
                f"{self.name} has the configuration fingerprint {list(found)} (0x1020), the rig file says "
                f"{list(expected)}: its parameters have been changed",
                "with no needle in tissue, power it off and on, which restores its stored parameters; if that does not "
                "help, compare them in EPOS Studio and enter the new fingerprint in the rig file",
            )

    # Settings

    def settings_of(self, heartbeat: HeartbeatDescription) -> dict[Entry, int]:
        """Return the settings of its section; from now on 0x1020 is to hold their fingerprint."""
        settings = drive_settings(self.section, heartbeat)
        self.expect_fingerprint(self.section.configuration_fingerprint or fingerprint(settings))
        return settings

    def expect_fingerprint(self, fingerprint: tuple[int, int]) -> None:
        """Set the fingerprint that 0x1020 is to hold; the drive clears it when a setting is changed."""
        self._expected_fingerprint = fingerprint

    def write_settings(self, settings: Mapping[Entry, int]) -> tuple[str, ...]:
        """Write the settings that differ, and the fingerprint again."""
        written = super().write_settings(settings)
        self._renew_fingerprint()
        return written

    def adjust(self, settings: Mapping[Entry, int]) -> bool:
        """Write the settings that operation needs and that differ; the drive keeps its fingerprint."""
        written = [entry for entry, value in settings.items() if self.ensure(entry, value)]
        if written:
            self._renew_fingerprint()
        return bool(written)

    def restore_limits(self, own: Mapping[Entry, int]) -> None:
        """Write the drive's own limits again, and leave its fingerprint as it is, also after a reset of its node."""
        found = self.fingerprint()
        super().restore_limits(own)
        self.ensure(od.CONFIGURATION_DATE, found[0])
        self.ensure(od.CONFIGURATION_TIME, found[1])

    def fingerprint(self) -> tuple[int, int]:
        """Return the date and time in 0x1020, which the drive clears when a setting is changed."""
        return self.upload(od.CONFIGURATION_DATE), self.upload(od.CONFIGURATION_TIME)

    def _renew_fingerprint(self) -> None:
        """Write 0x1020 again, except to a drive that has restarted: its settings are unknown."""
        if self._expected_fingerprint is not None and not self.has_restarted:
            self.ensure(od.CONFIGURATION_DATE, self._expected_fingerprint[0])
            self.ensure(od.CONFIGURATION_TIME, self._expected_fingerprint[1])

    def stop_options(self) -> dict[Entry, int]:
        """Return the option codes by which the drive stops; it has none for a quick stop."""
        return dict(STOP_OPTIONS)

    def require_limits(self) -> None:
        """Refuse a current limit or a speed of the rig file above the drive's own. Raises `DriveError`."""
        require_all((super().require_limits, self._require_motor_speed))

    def _require_motor_speed(self) -> None:
        own_rpm = self.upload(od.MAX_MOTOR_SPEED)
        rpm = self.scale.to_speed_units(self.section.max_speed)
        if rpm > own_rpm:
            unit = self.section.unit
            raise DriveError(
                f"{self.name} limits its motor to {own_rpm} rpm ({od.MAX_MOTOR_SPEED.place}), max_speed "
                f"{self.section.max_speed:g} {unit}/s of the rig file is {rpm} rpm",
                f"write max_speed: {self.scale.to_speed(own_rpm):.4g} or less, or correct the limit in {self.tool}",
            )

    def find_current_limit(self) -> tuple[Entry, float] | None:
        """Return the output current limit, in mA."""
        return od.MAX_CURRENT, 1.0

    def describe(self) -> dict[str, object]:
        """Return conversion factors and settings of the drive, for the record."""
        return {
            "node_id": self.node_id,
            "quadcounts_per_unit": self.scale.counts_per_unit,
            "rpm_per_speed": self.scale.speed_units_per_speed,
            "position_window_quadcounts": self.scale.to_distance_counts(self.section.position_window),
            **super().describe(),
        }

    def name_sent(self, counter: int, speed_units: int) -> dict[str, int]:
        """Return quadcounts and rpm."""
        return {"sent_quadcounts": counter, "sent_rpm": speed_units}

    # Reference

    def homing_settings(self, homing: Homing) -> Iterator[tuple[Entry, int]]:
        """Yield the settings that a homing needs; homing to a stop has a current threshold."""
        section, scale = self.section, self.scale
        offset = round(homing.offset * scale.counts_per_unit)
        yield co.HOME_OFFSET, -HOMING_DIRECTIONS.get(homing.method, 0) * offset
        yield od.HOME_POSITION, self.home_counter(homing)
        if homing.method != HOMING_HERE:
            rpm = scale.to_speed_units(homing.speed)
            yield co.HOMING_SPEED_SWITCH, rpm
            yield co.HOMING_SPEED_INDEX, max(1, rpm // 10)
            yield co.HOMING_ACCELERATION, scale.to_acceleration_units(section.acceleration)
        if homing.method in BY_CURRENT:
            yield od.CURRENT_THRESHOLD, section.homing.current_threshold_ma

    # Condition

    def describe_emergency(self, code: int) -> Emergency:
        """Return what an error code means; a code that no document lists is called unknown."""
        return describe_emergency(code)

    def find_current(self) -> tuple[Entry, float] | None:
        """Return the averaged motor current, in mA: it has no ripple of the power stage in it."""
        return od.CURRENT_AVERAGE, 1.0

    def find_following_error(self) -> Entry | None:
        """Return the following error."""
        return od.FOLLOWING_ERROR_ACTUAL

    def find_input(self, source: str) -> InputPlace | None:
        """Return where an input of the drive is read. Raises `DriveError` if its mask hides the input."""
        if source in ANALOG_INPUTS:
            return InputPlace(ANALOG_INPUTS[source], volts=_MILLIVOLT)
        bit = self.section.digital_inputs.get(source)
        if bit is None:
            return None
        mask = self.upload(od.INPUT_MASK)
        if not mask >> bit & 1:
            raise DriveError(
                f"{self.name} hides its input {source}, which would always read off: the mask 0x2071:02 is "
                f"{mask:#06x}, without bit {bit}",
                f"set bit {bit} of the mask in EPOS Studio and save it, or use an input that the mask shows",
            )
        return InputPlace(od.INPUT_STATE, bit=bit)

    def inputs(self) -> dict[str, bool]:
        """Return the digital inputs by function, with the drive's polarity settings applied."""
        word = self.upload(od.INPUT_STATE)
        return {name: bool(word >> bit & 1) for name, bit in self.section.digital_inputs.items()}
