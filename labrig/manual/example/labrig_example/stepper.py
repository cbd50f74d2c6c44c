"""The driver `example-stepper`, a CiA 402 stepper drive: the section of its axis, and what is known of it."""

from dataclasses import replace
from typing import Literal

from pydantic import Field

from labrig.devices.axis_description import AxisDescription
from labrig.devices.drives.eds import read_own_eds
from labrig.devices.drives.model import Model
from labrig.devices.drives.objects import Place

VENDOR, PRODUCT = 0x7E57, 0x0001


class StepperAxis(AxisDescription):
    """One axis with a stepper drive. Lengths are mm, or rad where `unit` is rad."""

    driver: Literal["example-stepper"] = Field("example-stepper", description="Kind of drive.")

    def model(self) -> Model:
        """Return what is known of the stepper; a drive of your own has an EDS file of its own (`read_eds`)."""
        own = read_own_eds("epos4.eds")
        own = replace(own, vendor=VENDOR, product=PRODUCT, product_name="example stepper")
        return Model(own, home_position=Place(0x30B0), referenced_bit=15)


DRIVE = StepperAxis
"""What the entry point names."""
