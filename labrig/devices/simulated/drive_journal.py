"""What a simulated drive did, and when. Tests assert on this, not on the computer's clock."""

from collections import deque
from collections.abc import Iterator
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


class DriveJournal:
    """The last events of a drive, oldest first."""

    def __init__(self) -> None:
        self._events: deque[DriveEvent] = deque(maxlen=_KEPT)

    def __iter__(self) -> Iterator[DriveEvent]:
        """Iterate over the events."""
        return iter(tuple(self._events))

    def note(self, event: DriveEvent) -> None:
        """Append an event."""
        self._events.append(event)

    def last(self, kind: str) -> DriveEvent | None:
        """Return the newest event of a kind, or None."""
        return next((event for event in reversed(self._events) if event.kind == kind), None)

    def since(self, t_s: float) -> tuple[DriveEvent, ...]:
        """Return the events from an instant on."""
        return tuple(event for event in self._events if event.t_s >= t_s)
