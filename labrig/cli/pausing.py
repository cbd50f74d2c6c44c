"""Pauses of a run that is made at this terminal: by Ctrl+C, and by `labrig pause` in another one."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from labrig.cli.output import say
from labrig.cli.signals import SignalNote
from labrig.errors import DiskError
from labrig.posix import is_in_background
from labrig.runner.pausing import PauseRequests
from labrig.runner.run_control import RunControl

_BY_KEY, _BY_COMMAND = "Ctrl+C", "labrig pause"


def may_pause() -> bool:
    """Return whether Ctrl+C may pause a run now: somebody must be able to read that, and to continue it."""
    at_terminal = sys.stdin.isatty() and sys.stderr.isatty()
    return at_terminal and not is_in_background(sys.stdin)


class RunRequests(PauseRequests):
    """Requests to pause one run.

    Parameters
    ----------
    note : SignalNote
        Notes Ctrl+C.
    control : RunControl or None
        Takes the requests of other terminals; None if it could not be opened.
    """

    def __init__(self, note: SignalNote, control: RunControl | None) -> None:
        self._note = note
        self._control = control
        self._announced = False

    def find(self, point: str) -> str | None:  # noqa: ARG002 - a request is met at any safe point
        """Return by what a pause is asked for."""
        if self._note.asks_for_pause:
            return _BY_KEY
        return _BY_COMMAND if self._control is not None and self._control.asks_for_pause else None

    def announce(self, when: str) -> None:
        """Say at the terminal, once for each request, when the pause will begin."""
        by = self.find("")
        if by is None:
            self._announced = False
        elif not self._announced:
            self._announced = True
            again = "; Ctrl+C again stops now" if by == _BY_KEY else ""
            say(f"{by}: pausing {when}{again}")

    def begin(self) -> None:
        """Note that the pause has begun."""
        self._announced = False
        self._note.meet_pause()
        if self._control is not None:
            self._control.note(paused=True)

    def find_continuation(self) -> str | None:
        """Return that `labrig continue` was called."""
        if self._control is None or not self._control.asks_to_continue:
            return None
        say("labrig continue: the run goes on")
        return "labrig continue"

    def end(self) -> None:
        """Note that the run continues."""
        if self._control is not None:
            self._control.note(paused=False)


@contextmanager
def take_requests(note: SignalNote, run: Path) -> Iterator[RunRequests]:
    """Take requests to pause a run during the block."""
    try:
        control: RunControl | None = RunControl(run)
    except DiskError as error:
        say(f"note: labrig pause cannot reach this run: {error.message}")
        control = None
    try:
        with note.pausing(enabled=True):
            yield RunRequests(note, control)
    finally:
        if control is not None:
            control.close()
