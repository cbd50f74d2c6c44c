"""The driver `example-stepper`, a CiA 402 stepper drive: the section of its axis, and what is known of it."""

from dataclasses import replace
from typing import Annotated, Literal

from pydantic import Field

from labrig.devices.drives.eds import read_own_eds
from labrig.devices.drives.model import Model
from labrig.devices.drives.objects import Place
from labrig.devices.drives.section import ProductSection
from labrig.devices.homing import HOMING_HERE
from labrig.devices.units import AxisScale

VENDOR, PRODUCT = 0x7E57, 0x0001
_NAME = "example stepper"


class StepperAxis(ProductSection):
    """One axis with a stepper drive. Lengths are mm, or rad where `unit` is rad."""

    factory_settings = {"microsteps_per_turn": 3200}  # noqa: RUF012 - as the base class declares it
    homing_directions = {HOMING_HERE: 0}  # noqa: RUF012 - as the base class declares it

    driver: Literal["example-stepper"] = Field("example-stepper", description="Kind of drive.")
    microsteps_per_turn: Annotated[int, Field(ge=200, le=51_200)] = Field(
        description="Microsteps per turn of the motor [-]."
    )

    def scale_of(self, gear_ratio: float, travel_per_turn: float) -> AxisScale:
        """Return the conversion to microsteps and rpm."""
        return AxisScale(self.microsteps_per_turn, gear_ratio, travel_per_turn, self.reversed)

    def model(self) -> Model:
        """Return what is known of the stepper; a drive of your own has an EDS file of its own (`read_eds`)."""
        own = replace(read_own_eds("epos4.eds"), vendor=VENDOR, product=PRODUCT, product_name=_NAME)
        return Model(
            own,
            {PRODUCT: _NAME},
            home_position=Place(0x30B0),
            home_here=HOMING_HERE,
            referenced_bit=15,
        )


DRIVE = StepperAxis
"""What the entry point names."""
