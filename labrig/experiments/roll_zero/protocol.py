"""The protocol that finds the roll zero of a needle as it is clamped."""

from collections.abc import Iterator
from typing import ClassVar, Literal

from pydantic import Field

from labrig.protocol.model import Conflict, Line
from labrig.protocol.sections import (
    Advance,
    GridSentinel,
    MovingProtocol,
    Needle,
    NeedleInPicture,
    RollZeroSteps,
    Sheath,
    check_sheath,
)


class RollZeroProtocol(MovingProtocol):
    """Find the roll of the rotation axis that bends the needle towards -y, and certify it for the needle as clamped."""

    pictures_decide_motion: ClassVar[bool] = True

    experiment: Literal["roll-zero"] = Field(description="Which experiment this file describes.")
    title: Line = Field("Roll zero", description="Heading of the report.")
    needle: Needle = Field(description="The needle of the run.")
    sheath: Sheath = Field(description="The tube that brings the needle into the gel.")
    insertion: Advance = Field(description="How fast the needle goes in and comes out.")
    roll_zero: RollZeroSteps = Field(description="How the zero is found.")
    sentinel: GridSentinel | None = Field(
        None, description="Grid pictures before and after the run; null for none."
    )

    @property
    def expected_radius_mm(self) -> float:
        """The design radius of the needle."""
        return self.needle.design_radius_mm

    @property
    def pictured_needle(self) -> NeedleInPicture:
        """Needle and sheath of the run."""
        return NeedleInPicture(self.needle.diameter_mm, self.sheath.diameter_mm)

    def conflicts(self) -> Iterator[Conflict]:
        """Yield a sheath that is too narrow for the needle."""
        yield from check_sheath("sheath.diameter_mm", self.sheath.diameter_mm, self.needle.diameter_mm)


Protocol = RollZeroProtocol
