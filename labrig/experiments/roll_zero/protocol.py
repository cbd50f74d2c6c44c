"""The protocol that finds the roll zero of a needle as it is clamped."""

from typing import ClassVar, Literal

from labrig.protocol.model import Line
from labrig.protocol.sections import RollZeroSearch, RollZeroSteps


class RollZeroProtocol(RollZeroSearch):
    """Find the position of the rotation axis that bends the needle towards -y, and certify it for the needle."""

    pictures_decide_motion: ClassVar[bool] = True

    experiment: Literal["roll-zero"]
    """Which experiment this file describes."""
    title: Line = "Roll zero"
    """Heading of the report."""
    roll_zero: RollZeroSteps
    """How the zero is found."""


Protocol = RollZeroProtocol
