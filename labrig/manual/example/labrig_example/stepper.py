"""The driver `example-stepper`, a CiA 402 stepper drive: the section of its axis, and what is known of it."""

from dataclasses import replace
from typing import Annotated, Literal

from pydantic import Field

from labrig.devices.drives import objects as co
from labrig.devices.drives.drive import Identity
from labrig.devices.drives.eds import read_own_eds
from labrig.devices.drives.model import Asked, Model
from labrig.devices.drives.objects import Place
from labrig.devices.drives.section import ProductSection
from labrig.devices.homing import HOMING_HERE
from labrig.devices.simulated.cia402 import Behaviour
from labrig.devices.simulated.kinds import CIA402
from labrig.devices.units import AxisScale
from labrig.errors import DriveError

VENDOR, PRODUCT = 0x7E57, 0x0001


class StepperAxis(ProductSection):
    """One axis with a stepper drive. Lengths are mm, or rad where `unit` is rad."""

    factory_settings = {"microsteps_per_turn": 3200}  # noqa: RUF012 - as the base class declares it
    homing_directions = {HOMING_HERE: 0}  # noqa: RUF012 - as the base class declares it
    count_unit = "microsteps"

    driver: Literal["example-stepper"] = Field("example-stepper", description="Kind of drive.")
    microsteps_per_turn: Annotated[int, Field(ge=200, le=51_200)] = Field(
        description="Microsteps per turn of the motor [-]."
    )

    def scale_of(self, gear_ratio: float, travel_per_turn: float) -> AxisScale:
        """Return the conversion to microsteps and rpm."""
        return AxisScale(self.microsteps_per_turn, gear_ratio, travel_per_turn, self.reversed)

    def find_behaviour(self) -> Behaviour:
        """Return how a simulated one behaves: as CiA 402 says."""
        own = {co.VENDOR_ID: VENDOR, co.PRODUCT_CODE: PRODUCT, co.SERIAL_NUMBER: 7000 + self.node_id}
        return replace(CIA402, fixed=own)

    def model(self) -> Model:
        """Return what is known of the stepper; a drive of your own has an EDS file of its own (`read_eds`)."""
        return Model(
            read_own_eds("epos4.eds"),
            _identify,
            home_position=Place(0x30B0),
            home_here=HOMING_HERE,
            referenced_bit=15,
        )


def _identify(drive: Asked) -> Identity:
    """Return the identity of a drive. Raises `DriveError` if it is another one."""
    found = (drive.upload(co.VENDOR_ID), drive.upload(co.PRODUCT_CODE))
    if found != (VENDOR, PRODUCT):
        raise DriveError(
            f"{drive.name} is vendor 0x{found[0]:X}, product 0x{found[1]:X}, expected 0x{VENDOR:X}, 0x{PRODUCT:X}",
            "check the node id in the rig file and the drive itself",
        )
    return Identity("example stepper", drive.upload(co.SERIAL_NUMBER))


DRIVE = StepperAxis
"""What the entry point names."""
