"""`Model`: what labrig knows of a product beyond CiA 402, as the section of its axis has it, for the one driver."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from labrig.devices.drives import objects as co
from labrig.devices.drives.drive import HOMING_HERE
from labrig.devices.drives.eds import Eds
from labrig.devices.drives.objects import Place

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
        Types of the product by their product codes, of which the bits `type_mask` count; empty: that of the EDS file.
    revisions : range or None
        Revisions that it may have; None: all.
    advice : str
        What to do about a drive of another type.
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
    """

    eds: Eds
    types: Mapping[int, str] = field(default_factory=dict)
    type_mask: int = 0xFFFFFFFF
    revisions: range | None = None
    advice: str = "check node id and EDS file in the rig file"
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
    home_here: int = HOMING_HERE
    referenced_bit: int | None = None
    inputs: Place = co.DIGITAL_INPUTS
    input_mask: Place | None = None
    analog: Mapping[str, Place] = field(default_factory=dict)
    fingerprint: tuple[Place, ...] = ()
    expected_fingerprint: tuple[int, ...] | None = None
    needs: tuple[Place, ...] = ()

    def has(self, place: Place) -> bool:
        """Tell whether the drive has an object."""
        return place in self.eds.objects

    def takes(self, place: Place) -> bool:
        """Tell whether the drive has an object that can be written."""
        return self.has(place) and self.eds.objects[place].writable
