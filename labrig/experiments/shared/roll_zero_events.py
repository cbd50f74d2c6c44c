"""Events of finding the roll zero of a needle, in a run of its own or before an insertion."""

import math
from typing import ClassVar

from labrig.experiments.shared.sheath_event import SheathEvent
from labrig.record.events import Event, PictureRole
from labrig.steering.roll_zero import RollZeroFit
from labrig.steering.torsion_fit import TorsionFit


class RollZeroRole(PictureRole):
    """Pictures of a hole: the sheath before the needle leaves it, and the inserted needle.

    For the torsion: the needle at the turn to 90 degrees, and at the end.
    """

    SHEATH = "roll-zero-sheath"
    NEEDLE = "roll-zero"
    TORSION_TURN = "torsion-turn"
    TORSION_END = "torsion-end"


class RollZeroSheath(SheathEvent):
    """The sheath in a hole; holes count as trials."""

    kind: ClassVar[str] = "roll_zero_sheath"


class RollZeroFound(Event):
    """The lateral deflection at each roll, without the perspective, and the fitted cosine."""

    kind: ClassVar[str] = "roll_zero"

    needle_id: str
    roll_rad: tuple[float, ...]
    deflection_mm: tuple[float, ...]
    fit: RollZeroFit


class TorsionHole(Event):
    """A hole for the torsion: the depth of its turn to 90 degrees, from below (1) or above (-1), and its pictures."""

    kind: ClassVar[str] = "torsion_hole"

    hole: int
    depth_mm: float
    direction: int
    turn_frame: int
    end_frame: int


class TorsionFound(Event):
    """The fitted lag of the bevel behind the rotation axis."""

    kind: ClassVar[str] = "torsion"

    needle_id: str
    fit: TorsionFit


def explain_doubt(what: str, sd_rad: float, most_deg: float) -> str | None:
    """Return why a fitted angle is too uncertain to be kept; None if it is not."""
    sd_deg = math.degrees(sd_rad)
    return f"{what} is uncertain by {sd_deg:.1f} degrees, {most_deg:g} at most" if sd_deg > most_deg else None
