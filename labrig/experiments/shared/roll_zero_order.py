"""What a roll zero is found for, in a run of its own or before an insertion."""

from dataclasses import dataclass

from labrig.protocol.sections import Advance, GridSentinel, Needle, RollZeroSteps, Sheath


@dataclass(frozen=True)
class RollZeroOrder:
    """What to find a roll zero for: the needle, the steps, and the expected radius."""

    needle: Needle
    sheath: Sheath
    advance: Advance
    steps: RollZeroSteps
    radius_mm: float
    sentinel: GridSentinel | None = None
