"""The protocol that finds the roll zero of a needle as it is clamped."""

from collections.abc import Iterator
from typing import ClassVar, Literal

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

    experiment: Literal["roll-zero"]
    """Which experiment this file describes."""
    title: Line = "Roll zero"
    """Heading of the report."""
    needle: Needle
    """The needle of the run."""
    sheath: Sheath
    """The tube that brings the needle into the gel."""
    insertion: Advance
    """How fast the needle goes in and comes out."""
    roll_zero: RollZeroSteps
    """How the zero is found."""
    sentinel: GridSentinel | None = None
    """Grid pictures before and after the run; null for none."""

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
