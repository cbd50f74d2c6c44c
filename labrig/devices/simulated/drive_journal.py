"""What a simulated drive did, and when. Tests assert on this, not on the computer's clock."""

from collections import deque
from dataclasses import dataclass

_KEPT = 10_000


@dataclass(frozen=True)
class DriveEvent:
    """An event of a drive.

    Parameters
    ----------
    t_s : float
        The exact instant, not that of the tick that noticed it.
    kind : str
        boot, nmt, state, emergency, set-point, brake, still or homing.
    text : str
        The state entered, the error code, or similar.
    shaft_counts : float
        Position of the shaft.
    """

    t_s: float
    kind: str
    text: str
    shaft_counts: float


class DriveJournal(deque[DriveEvent]):
    """The last events of a drive, oldest first."""

    def __init__(self) -> None:
        super().__init__(maxlen=_KEPT)

    def last(self, kind: str) -> DriveEvent | None:
        """Return the newest event of a kind, or None."""
        return next((event for event in reversed(self) if event.kind == kind), None)
