"""`Model`: what labrig knows of a product beyond CiA 402, as the section of its axis has it, for the one driver."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from labrig.devices.axis_description import AxisDescription
from labrig.devices.drives import objects as co
from labrig.devices.drives.drive import Homing
from labrig.devices.drives.eds import Eds
from labrig.devices.drives.objects import Place
from labrig.devices.homing import HOMING_HERE
from labrig.errors import InputError

STOP_OPTIONS = {
    co.ABORT_CONNECTION: 1,  # a fault
    co.SHUTDOWN_OPTION: 1,  # brake, then switch power off
    co.DISABLE_OPTION: 1,  # brake, then switch power off
    co.FAULT_REACTION: 2,  # brake with the quick stop deceleration
}
"""Option codes with which a drive brakes wherever the profile lets it choose."""


class Stated(NamedTuple):
    """Something that the rig file states and the drive may report: they are compared, and never written.

    Attributes
    ----------
    place : Place
        Where the drive reports it.
    key : str
        Its key in the rig file.
    value : float, str or None
        What the rig file says; None: unknown.
    raw : int or None
        The same as the drive reports it; None where labrig knows no code for it.
    read : callable
        Returns what a value of the object means; None for one that labrig does not know.
    """

    place: Place
    key: str
    value: float | str | None
    raw: int | None
    read: Callable[[int], float | str | None] = int


@dataclass(frozen=True)
class Model:
    """A product, as the section of its axis has it.

    Parameters
    ----------
    eds : Eds
        Its objects.
    types : mapping of int to str
        Types of the product by what the object `type_at` reads, of its bits `type_mask`.
    versions : range or None
        Its versions; None: all.
    tried : tuple of int
        Versions that its EDS file is for; none: any.
    type_name, version_name : str
        What the two are called in a record.
    type_at, version_at : Place
        Where they stand.
    advice, doubt : str
        What to do about a drive of another type, and what `labrig devices check` warns of.
    settings, stop_options : mapping of Place to int
        What is written beside the settings of every axis; and the option codes by which it stops by itself.
    errors : str
        The table in `errors.csv` with the maker's own error codes.
    stated : tuple of Stated
        What is compared with the rig file.
    tool : str
        The maker's program, for hints.
    reset_communication_first : frozenset of int
        Errors that are reset only after the communication has been.
    current_ma, current_limit_ma, following_error, motor_speed_limit : Place or None
        Where they stand. Without the first two, currents are those of CiA 402, in thousandths of the rated one.
    home_position, home_offset, homing_current : Place or None
        Counter at home, distance to move off the stop first, and the current that shows a stop.
    home_here : int
        The drive's number for homing where the axis is.
    referenced_bit : int or None
        Bit of the statusword that is set while the drive has its reference.
    inputs, input_mask : Place or None
        Word of the digital inputs, and what hides some of them.
    analog : mapping of str to Place
        Analog inputs by name [mV].
    fingerprint : tuple of Place
        What the drive clears when a setting changes; labrig writes it back.
    expected_fingerprint : tuple of int or None
        What the rig file says that it is.
    needs : tuple of Place
        Objects that the rig file names: the drive must have them.
    sent_names : tuple of str
        Names of counts and of units of speed in a record.
    """

    eds: Eds
    types: Mapping[int, str]
    versions: range | None = None
    tried: tuple[int, ...] = ()
    type_name: str = "product_code"
    type_at: Place = co.PRODUCT_CODE
    type_mask: int = 0xFFFFFFFF
    version_name: str = "revision_number"
    version_at: Place = co.REVISION
    advice: str = "check node id and EDS file in the rig file"
    doubt: str = ""
    settings: Mapping[Place, int] = field(default_factory=dict)
    stop_options: Mapping[Place, int] = field(default_factory=lambda: STOP_OPTIONS)
    errors: str = ""
    stated: tuple[Stated, ...] = ()
    tool: str = "the program of its manufacturer"
    reset_communication_first: frozenset[int] = frozenset({0x8120, 0x8130, 0x8140, 0x81FD})
    current_ma: Place | None = None
    current_limit_ma: Place | None = None
    following_error: Place = co.FOLLOWING_ERROR
    motor_speed_limit: Place | None = None
    home_position: Place | None = None
    home_offset: Place | None = None
    homing_current: Place | None = None
    home_here: int = 35
    referenced_bit: int | None = None
    inputs: Place = co.DIGITAL_INPUTS
    input_mask: Place | None = None
    analog: Mapping[str, Place] = field(default_factory=dict)
    fingerprint: tuple[Place, ...] = ()
    expected_fingerprint: tuple[int, ...] | None = None
    needs: tuple[Place, ...] = ()
    sent_names: tuple[str, str] = ("sent_counts", "sent_speed_units")

    def has(self, place: Place) -> bool:
        """Tell whether the drive has an object."""
        return place in self.eds.objects

    def takes(self, place: Place) -> bool:
        """Tell whether the drive has an object that can be written."""
        return self.has(place) and self.eds.objects[place].writable

    def list_settings(self, section: AxisDescription) -> dict[Place, int]:
        """Return the settings of an axis that the drive takes. Raises `InputError` if its gear is unknown."""
        scale = section.scale()
        acceleration = scale.to_acceleration_units(section.acceleration)
        wanted = {
            co.MAX_FOLLOWING_ERROR: scale.to_distance_counts(section.max_following_error),
            co.POSITION_WINDOW: scale.to_distance_counts(section.position_window),
            co.POSITION_WINDOW_TIME: section.position_window_time_ms,
            co.MAX_PROFILE_VELOCITY: scale.to_speed_units(section.max_speed),
            co.PROFILE_ACCELERATION: acceleration,
            co.PROFILE_DECELERATION: acceleration,
            co.QUICK_STOP_DECELERATION: scale.to_acceleration_units(section.quick_stop_deceleration),
            co.PROFILE_TYPE: 0,
            **self.settings,
        }
        return {place: value for place, value in wanted.items() if self.takes(place)}

    def list_homing_settings(self, section: AxisDescription, homing: Homing) -> dict[Place, int]:
        """Return the settings that a homing needs. Raises `InputError` if the drive lacks one of them."""
        scale, method = section.scale(), homing.method
        if (homing.offset and self.home_offset is None) or (homing.position and self.home_position is None):
            raise InputError(
                f"homing has position {homing.position:g} and offset {homing.offset:g}, and no object of the drive is "
                "known for one of them",
                "write 0, and jog after homing; or name the object of the position in objects.home_position",
            )
        settings = {
            co.HOMING_METHOD: self.home_here if method == HOMING_HERE else method,
            co.HOME_OFFSET: 0,
        }
        if self.home_offset is not None:
            away = -section.homing_directions.get(method, 0)
            settings[self.home_offset] = away * round(homing.offset * scale.counts_per_unit)
        if self.home_position is not None:
            settings[self.home_position] = scale.to_counts(homing.position)
        if method != HOMING_HERE:
            units = scale.to_speed_units(homing.speed)
            settings[co.HOMING_SPEED_SWITCH] = units
            settings[co.HOMING_SPEED_INDEX] = max(1, units // 10)
            settings[co.HOMING_ACCELERATION] = scale.to_acceleration_units(section.acceleration)
        threshold_ma = section.homing_current_ma(method)
        if self.homing_current is not None and threshold_ma is not None:
            settings[self.homing_current] = threshold_ma
        return {place: value for place, value in settings.items() if self.has(place)}


class Cia402Section(AxisDescription):
    """The section of an axis with a CiA 402 drive; a product derives its own from `section.ProductSection`."""

    def model(self) -> Model:
        """Return what is known of the drive. Raises `InputError` if its EDS file cannot be read."""
        raise NotImplementedError
