"""The first difference between a replay and its record, with both values and the picture at which it occurs."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NoReturn

from labrig.devices.replayed.clock import ReplayedClock
from labrig.devices.replayed.recording import Recording
from labrig.errors import LabrigError, RecordEndsError, ReplayDiffersError


@dataclass(frozen=True)
class ReplayDifference:
    """The first difference between a replay and its record.

    Attributes
    ----------
    what : str
        `command`, `question`, `event`, `state`, `frame` or `truth`.
    recorded, now : str
        What the record has, and what the replay did; "nothing" when one of them had ended.
    t_s : float
        Rig time of the record [s].
    frame : int or None
        The last picture that had been taken.
    trial : int or None
        The insertion.
    """

    what: str
    recorded: str
    now: str
    t_s: float
    frame: int | None
    trial: int | None


@dataclass(frozen=True)
class DifferingLines:
    """A line of the record, and that of the replay, as far as they are compared; `what` as in `ReplayDifference`."""

    what: str
    recorded: Mapping[str, Any]
    now: Mapping[str, Any]


class Comparison:
    """What has been compared so far, and where. Nothing continues after the first difference.

    Parameters
    ----------
    recording : Recording
        The session that is replayed.

    Attributes
    ----------
    clock : ReplayedClock
        Its rig time.
    frame, trial : int or None
        The last picture, the insertion.
    counts : dict
        How many items of each kind were the same.
    found : ReplayDifference or None
        The first difference.
    lines : DifferingLines or None
        The two lines in which it is; None if it is in no line.
    """

    def __init__(self, recording: Recording) -> None:
        self.clock = ReplayedClock(recording.started)
        self.frame: int | None = None
        self.trial: int | None = None
        self.counts: dict[str, int] = {}
        self.found: ReplayDifference | None = None
        self.lines: DifferingLines | None = None
        self._recording = recording
        self._over: LabrigError | None = None

    def count_same(self, what: str) -> None:
        """Count an item that was the same."""
        self.counts[what] = self.counts.get(what, 0) + 1

    def require_ongoing(self) -> None:
        """Raise again what ended the replay: a procedure that ends stops its axes, which is not part of the replay."""
        if self._over is not None:
            raise self._over

    def make_difference(self, what: str, recorded: str, now: str) -> ReplayDifference:
        """Return a difference at the present position."""
        t_s = self._recording.span.t0_s + self.clock.now_s()
        return ReplayDifference(what, recorded, now, t_s, self.frame, self.trial)

    def raise_difference(self, what: str, recorded: str, now: str) -> NoReturn:
        """End the replay with `ReplayDiffersError`, which carries the difference."""
        self.require_ongoing()
        self.found = self.make_difference(what, recorded, now)
        self._over = ReplayDiffersError(f"{what}: the record has {recorded}; the replay has {now}")
        raise self._over

    def raise_end(self, what: str, now: str) -> NoReturn:
        """End the replay when the record has nothing more of a kind: an end if it was cut short, else a difference."""
        self.require_ongoing()
        if self._recording.to_the_end:
            self.raise_difference(what, "nothing", now)
        t0_s = self._recording.span.t0_s
        self._over = RecordEndsError(
            f"the session that began at t = {t0_s:.3f} s was interrupted at t = {t0_s + self.clock.now_s():.3f} s"
        )
        raise self._over
