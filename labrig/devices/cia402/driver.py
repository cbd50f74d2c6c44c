"""The driver of any CiA 402 drive in profile position mode; its EDS file states which objects it has.

What is decided here
--------------------
- Object widths are those of the EDS file, and a value out of an object's range is refused before it is sent. If the EDS
  file cannot be read, the widths of the standard are used: enough to stop the drive, and `identify` refuses it.
- Units are compared if the drive reports them (0x60A9, 0x60AA) and never written; the same holds for counts per turn.
- A lost heartbeat, a fault and a quick stop have option codes (0x6007, 0x605E, 0x605A); all three are set. CiA 402
  allows 0 in 0x6007, with which the axis would keep moving.
- Bit 15 of the statusword is manufacturer-specific: a reference counts after reopening only if the section names the
  bit that reports it.
- Home has position zero unless the section names the object for another position: makers differ in the sign of 0x607C.
- Uncertain until tried on a device: whether a drive accepts homing here by method 37 at once; whether a drive with
  0x6007 = 1 goes to fault when its heartbeat ends; whether both limits at 0 switch the limits of an EPOS4 off, as its
  EDS file has them.
"""

import math
from collections.abc import Iterator

from labrig.clock import Clock
from labrig.devices import canopen_objects as co
from labrig.devices.bus import CanLink
from labrig.devices.can_description import HeartbeatDescription
from labrig.devices.canopen_objects import Entry
from labrig.devices.cia402 import objects as od
from labrig.devices.cia402.eds import Eds
from labrig.devices.cia402.error_codes import describe_emergency
from labrig.devices.cia402.settings import ANALOG_KEYS, Cia402Axis, drive_settings
from labrig.devices.cia402.units import ACCELERATION_CODES, VELOCITY_CODES, read_unit
from labrig.devices.cia402_drive import ANSWER_TIME_S, POLL_S, STOP_OPTIONS, Cia402Drive, still_time_s
from labrig.devices.drive import Homing, Identity, require_all
from labrig.devices.drive_reports import InputPlace
from labrig.devices.error_codes import Emergency
from labrig.devices.homing import HOMING_HERE
from labrig.errors import DriveError, InputError

_PROFILE = 402
_NEEDED_MODES = {0: "profile position", 5: "homing"}
"""Bit of 0x6502 -> mode of operation."""

_SENT_IDS, _OBEYED_IDS = range(0x1800, 0x1A00), range(0x1400, 0x1600)
_MILLIVOLT = 0.001


class ProfileDrive(Cia402Drive[Cia402Axis]):
    """One CiA 402 drive.

    Parameters
    ----------
    link : CanLink
        The bus.
    section : Cia402Axis
        Its section of the rig file; may be incomplete, or name an EDS file that cannot be read.
    axis : str
        Name of its axis, for messages.
    clock : Clock
        Time for timeouts.
    """

    def __init__(self, link: CanLink, section: Cia402Axis, axis: str, clock: Clock) -> None:
        slowest = None
        if not section.unknown:
            scale = section.scale()
            slowest = scale.counts_per_turn / scale.speed_units
        super().__init__(
            link,
            section,
            axis,
            clock,
            node_id=section.node_id,
            still_time_s=still_time_s(slowest),
        )
        self._eds: Eds | None = None
        self._unreadable: InputError | None = None
        self._homed = False
        try:
            self._eds = section.read_eds()
        except InputError as error:
            self._unreadable = error

    # Objects

    @property
    def eds(self) -> Eds:
        """The content of the drive's EDS file. Raises `InputError`."""
        if self._eds is None:
            raise self._unreadable or InputError(f"{self.name} has no EDS file")
        return self._eds

    def own_entry(self, entry: Entry) -> Entry:
        """Return an object as the EDS file describes it, or as the standard does if that cannot be read."""
        return entry if self._eds is None else self._eds.entries.get(entry, entry)

    def has(self, entry: Entry) -> bool:
        """Tell whether the drive has an object by its EDS file."""
        return self._eds is not None and entry in self._eds.entries

    def download(self, entry: Entry, value: int) -> None:
        """Write a value to an object. Raises `DriveError` if it is out of range, and as `upload`."""
        own = self.own_entry(entry)
        low, high = own.bounds
        if not low <= value <= high:
            raise DriveError(
                f"{self.name} does not take {own.name} ({own.place}) = {value}, only {low} to {high}",
                "compare units and limits of this axis in the rig file with the drive's EDS file",
            )
        super().download(own, value)

    def ensure(self, entry: Entry, value: int) -> bool:
        """Write an object if it differs, and read it back; after a mode, wait until the drive is in it."""
        written = super().ensure(entry, value)
        if entry == co.MODE and self.has(co.MODE_DISPLAY):
            self._await_mode(value)
        return written

    def _await_mode(self, mode: int) -> None:
        deadline_s = self._clock.now_s() + ANSWER_TIME_S
        while (found := self.upload(co.MODE_DISPLAY)) != mode:
            if self._clock.now_s() > deadline_s:
                raise DriveError(
                    f"{self.name} stayed in mode of operation {found} (0x6061) when {mode} was requested",
                    f"look at its status in {self.tool}",
                )
            self._clock.sleep(POLL_S)

    # Connecting

    def identify(self) -> Identity:
        """Return the identity of the drive after comparing units and counts per turn with its section.

        Raises
        ------
        DriveError
            When it is of another product than its EDS file, lacks a mode that labrig needs or uses other units, or when
            two drives answer.
        InputError
            When its EDS file cannot be read.
        """
        identity = self.read_identity()
        require_all((self.require_units, self.require_counts))
        return identity

    def read_identity(self) -> Identity:
        """Return the identity of the drive, whatever its settings. Raises as `identify`."""
        vendor = self.wake()
        strays = self.sdo.strays
        device_type, product = self.upload(co.DEVICE_TYPE), self.upload(co.PRODUCT_CODE)
        revision, serial, modes = map(self._optional, (co.REVISION, co.SERIAL_NUMBER, co.SUPPORTED_MODES))
        self.require_alone(strays)
        if device_type & 0xFFFF != _PROFILE:
            raise DriveError(
                f"{self.name} has device type 0x{device_type:08X} (0x1000:00), expected a CiA 402 drive",
                "check the node id in the rig file",
            )
        self._require_product(vendor, product)
        for bit, mode in _NEEDED_MODES.items():
            if modes is not None and not modes >> bit & 1:
                raise DriveError(
                    f"{self.name} has no mode {mode} (0x6502:00 is 0x{modes:08X})", "use another drive"
                )
        versions = {"vendor_id": vendor, "product_code": product}
        return Identity(
            self.eds.product_name,
            serial,
            versions if revision is None else versions | {"revision_number": revision},
        )

    def _require_product(self, vendor: int, product: int) -> None:
        eds = self.eds
        for place, number, found, expected in (
            (co.VENDOR_ID.place, "vendor", vendor, eds.vendor),
            (co.PRODUCT_CODE.place, "product", product, eds.product),
        ):
            if found != expected:
                raise DriveError(
                    f"{self.name} has {number} 0x{found:08X} ({place}), {eds.source} is for 0x{expected:08X} "
                    f"({eds.product_name})",
                    "name the EDS file of this drive in the rig file, or check its node id",
                )

    def _optional(self, entry: Entry) -> int | None:
        return self.upload(entry) if self.has(entry) else None

    def require_units(self) -> None:
        """Refuse a drive that reports other units than its section. Raises `DriveError`."""
        section = self.section
        for entry, codes, key, unit, factor in (
            (od.VELOCITY_UNIT, VELOCITY_CODES, "velocity", section.velocity_unit, section.velocity_factor),
            (
                od.ACCELERATION_UNIT,
                ACCELERATION_CODES,
                "acceleration",
                section.acceleration_unit,
                section.acceleration_factor,
            ),
        ):
            found = read_unit(self.upload(entry), codes) if self.has(entry) else None
            if found is not None and (found[0] != unit or not math.isclose(found[1], factor)):
                raise DriveError(
                    f"{self.name} takes {key} in {found[1]:g} {found[0]} ({entry.place}), the rig file says "
                    f"{factor:g} {unit}",
                    f"correct {key}_unit and {key}_factor in the rig file, or the drive in {self.tool}",
                )

    def require_counts(self) -> None:
        """Refuse a drive that reports other counts per turn than its section. Raises `DriveError`."""
        entry, expected = self.section.objects.entry("counts_per_turn"), self.section.counts_per_turn
        found = None if entry is None else self.upload(entry)
        if entry is not None and found != expected:
            raise DriveError(
                f"{self.name} counts {found} a turn ({entry.place}), the rig file says {expected or 0:g}",
                f"find out which encoder it has; correct the rig file, or the drive in {self.tool}",
            )

    def pdo_entries(self) -> tuple[tuple[Entry, ...], tuple[Entry, ...]]:
        """Return the COB-ID objects of all PDOs that its EDS file lists: of those sent, and of those obeyed."""
        entries = [entry for entry in self.eds.entries if entry.subindex == 1]
        sent = tuple(entry for entry in entries if entry.index in _SENT_IDS)
        return sent, tuple(entry for entry in entries if entry.index in _OBEYED_IDS)

    def settings_of(self, heartbeat: HeartbeatDescription) -> dict[Entry, int]:
        """Return the settings of its section, as far as the drive has them."""
        return drive_settings(self.section, heartbeat, self.eds)

    def stop_options(self) -> dict[Entry, int]:
        """Return the option codes by which the drive stops; `devices check` names those that it does not have."""
        section = self.section
        own = {
            co.ABORT_CONNECTION: section.abort_connection_option,
            od.QUICK_STOP_OPTION: section.quick_stop_option,
        }
        return {entry: value for entry, value in (STOP_OPTIONS | own).items() if self.has(entry)}

    def find_current_limit(self) -> tuple[Entry, float] | None:
        """Return the object that its section names, in mA; else 0x6073, in thousandths of the rated current 0x6075."""
        named = self.section.objects.entry("current_limit_ma")
        if named is not None:
            return self.own_entry(named), 1.0
        if not (self.has(od.MAX_CURRENT) and self.has(od.RATED_CURRENT)):
            return None
        rated_ma = self.upload(od.RATED_CURRENT)
        return (od.MAX_CURRENT, rated_ma / 1000) if rated_ma else None

    def describe(self) -> dict[str, object]:
        """Return conversion factors and settings of the drive, for the record."""
        return {
            "node_id": self.node_id,
            "eds": self.eds.product_name,
            "counts_per_unit": self.scale.counts_per_unit,
            "speed_units_per_speed": self.scale.speed_units_per_speed,
            "speed_unit": self.section.speed_unit,
            **super().describe(),
        }

    # Reference

    def homing_method(self, method: int) -> int:
        """Return the drive's own number of a homing method."""
        return self.section.home_here_method if method == HOMING_HERE else method

    def homing_settings(self, homing: Homing) -> Iterator[tuple[Entry, int]]:
        """Yield the settings that a homing needs."""
        home, scale = self.section.objects.entry("home_position"), self.scale
        if homing.offset or (homing.position and home is None):
            raise DriveError(
                f"{self.name} has no home position but zero and no distance off a switch, as far as labrig knows",
                "name the object of the home position in objects.home_position of this axis",
            )
        settings = {co.HOME_OFFSET: 0}
        if home is not None:
            settings[home] = self.home_counter(homing)
        if homing.method != HOMING_HERE:
            units = scale.to_speed_units(homing.speed)
            settings[co.HOMING_SPEED_SWITCH] = units
            settings[co.HOMING_SPEED_INDEX] = max(1, units // 10)
            settings[co.HOMING_ACCELERATION] = scale.to_acceleration_units(self.section.acceleration)
        yield from ((entry, value) for entry, value in settings.items() if self.has(entry))

    def start_homing(self, homing: Homing) -> None:
        """Start homing."""
        self._homed = False
        super().start_homing(homing)

    def finish_homing(self, homing: Homing) -> None:
        """Hold at home, after checking that the counter is near it: makers differ in the sign of a home position."""
        super().finish_homing(homing)
        counter, home = self.counter(), self.home_counter(homing)
        if abs(counter - home) > abs(counter + home):
            raise DriveError(
                f"{self.name} reads {counter} {self.section.count_unit} at home, {home} was requested: it uses the "
                "opposite sign for the home position",
                "leave objects.home_position out, and write homing.position: 0",
            )
        self._homed = True

    def is_referenced(self) -> bool:
        """Tell whether the drive has its reference; a drive that cannot tell has it only until it is closed."""
        bit = self.section.referenced_bit
        if bit is None:
            return self._homed and not self.has_restarted
        return bool(self.statusword() >> bit & 1)

    def set_limits(self, limits: tuple[float, float] | None) -> None:
        """Set the limits of the drive, if it has any."""
        if self.has(co.LOWER_LIMIT) and self.has(co.UPPER_LIMIT):
            super().set_limits(limits)

    # Condition

    def error_code(self) -> int:
        """Return the code of the newest error, from 0x603F or the error history."""
        code = self._optional(od.ERROR_CODE) or 0
        if code or not (self.has(co.ERROR_COUNT) and self.has(co.LAST_ERROR)):
            return code
        return super().error_code()

    def describe_emergency(self, code: int) -> Emergency:
        """Return what an error code means; a code that no standard lists is described by its class."""
        return describe_emergency(code)

    def find_current(self) -> tuple[Entry, float] | None:
        """Return the object that its section names, in mA; else 0x6078 or 0x6077, in thousandths of the rated current.

        The torque 0x6077 is in thousandths of the rated torque, which the motor has at its rated current 0x6075.
        """
        named = self.section.objects.entry("current_ma")
        if named is not None:
            return self.own_entry(named), 1.0
        found = next((entry for entry in (co.CURRENT_ACTUAL, od.TORQUE_ACTUAL) if self.has(entry)), None)
        if found is None or not self.has(od.RATED_CURRENT):
            return None
        rated_ma = self.upload(od.RATED_CURRENT)
        return (found, rated_ma / 1000) if rated_ma else None

    def find_following_error(self) -> Entry | None:
        """Return 0x60F4, if the drive has it."""
        return od.FOLLOWING_ERROR if self.has(od.FOLLOWING_ERROR) else None

    def find_input(self, source: str) -> InputPlace | None:
        """Return where an input of the drive is read: an object that its section names, or a bit of 0x60FD."""
        bit = self.section.digital_inputs.get(source)
        if bit is not None:
            return InputPlace(od.DIGITAL_INPUTS, bit=bit) if self.has(od.DIGITAL_INPUTS) else None
        named = self.section.objects.entry(ANALOG_KEYS[source])
        return None if named is None else InputPlace(self.own_entry(named), volts=_MILLIVOLT)

    def inputs(self) -> dict[str, bool]:
        """Return the digital inputs (0x60FD); empty if the drive does not report them."""
        word = self._optional(od.DIGITAL_INPUTS)
        bits = {} if word is None else self.section.digital_inputs
        return {name: bool((word or 0) >> bit & 1) for name, bit in bits.items()}
