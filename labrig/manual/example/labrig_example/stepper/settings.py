"""The section of an axis with `driver: example-stepper`."""

from typing import Annotated, Literal

from pydantic import Field

from labrig.devices.axis_description import AxisDescription
from labrig.devices.can_description import NodeId
from labrig.devices.homing import HOMING_HERE
from labrig.devices.units import AxisScale


class StepperAxis(AxisDescription):
    """One axis with a stepper drive. Lengths are mm, or rad where `unit` is rad."""

    homing_directions = {HOMING_HERE: 0}  # noqa: RUF012 - as the base class declares it
    count_unit = "microsteps"

    driver: Literal["example-stepper"] = Field("example-stepper", description="Kind of drive.")
    node_id: NodeId = Field(description="CANopen node id of the drive.")
    microsteps_per_turn: Annotated[int, Field(ge=200, le=51_200)] = Field(
        description="Microsteps per turn of the motor [-]."
    )

    @property
    def nodes(self) -> tuple[int, ...]:
        """The node id."""
        return (self.node_id,)

    def scale_of(self, gear_ratio: float, travel_per_turn: float) -> AxisScale:
        """Return the conversion to microsteps and rpm."""
        return AxisScale(self.microsteps_per_turn, gear_ratio, travel_per_turn, self.reversed)
