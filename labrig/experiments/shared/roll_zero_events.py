"""Events of finding the roll zero of a needle, in a run of its own or before an insertion."""

from typing import ClassVar

from labrig.experiments.shared.sheath_event import SheathEvent
from labrig.record.events import Event, PictureRole


class RollZeroRole(PictureRole):
    """Pictures of a hole: the sheath before the needle leaves it, and the inserted needle."""

    SHEATH = "roll-zero-sheath"
    NEEDLE = "roll-zero"


class RollZeroSheath(SheathEvent):
    """The sheath in a hole; holes count as trials."""

    kind: ClassVar[str] = "roll_zero_sheath"


class RollZeroFound(Event):
    """The lateral deflection at each roll, and the fitted cosine."""

    kind: ClassVar[str] = "roll_zero"

    needle_id: str
    roll_rad: tuple[float, ...]
    deflection_mm: tuple[float, ...]
    zero_rad: float
    sd_rad: float
    bend_mm: float
    expected_mm: float
    residual_rms_mm: float
