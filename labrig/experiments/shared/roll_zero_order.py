"""What a roll zero is found for, in a run of its own or before an insertion."""

import math
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


def explain_doubt(what: str, sd_rad: float, most_deg: float) -> str | None:
    """Return why a fitted angle is too uncertain to be kept; None if it is not."""
    sd_deg = math.degrees(sd_rad)
    return f"{what} is uncertain by {sd_deg:.1f} degrees, {most_deg:g} at most" if sd_deg > most_deg else None
