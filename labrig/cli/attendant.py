"""The person at the terminal attends a run: is told, is asked, pauses it and stops it."""

import sys
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, closing, contextmanager
from pathlib import Path

from labrig.cli.live import Follower
from labrig.cli.options import LiveKind
from labrig.cli.output import SPEAKS_JSON, say
from labrig.cli.progress import Reporter, load_bar, progress
from labrig.cli.signals import SignalNote, note_signals
from labrig.cli.terminal_operator import TerminalOperator
from labrig.devices.opening import Opening
from labrig.devices.rig import Rig, open_rig
from labrig.devices.rig_file import RigDescription
from labrig.posix import is_in_background
from labrig.runner.attendant import Attendant
from labrig.runner.dialogue import PauseRequests
from labrig.runner.run_control import RunControl

_BY_KEY, _BY_COMMAND = "Ctrl+C", "labrig pause"


class TerminalAttendant(Attendant):
    """Talks on standard error, asks at the terminal, and is interrupted by signals.

    Parameters
    ----------
    viewer : str or None
        How the run is shown while it is made.
    """

    def __init__(self, viewer: LiveKind | None = None) -> None:
        self._viewer = viewer
        self._follower: Follower | None = None

    def say(self, text: str) -> None:
        """Tell what happens."""
        say(text)

    def progress(self, title: str, total: float, lasts_s: float = 0.0) -> AbstractContextManager[Reporter]:  # type: ignore[override]
        """Show how much of the total is done."""
        return progress(title, total, lasts_s)

    @contextmanager
    def open_rig(
        self, rig: RigDescription, doing: str, seed: int = 0, opening: Opening | None = None
    ) -> Iterator[tuple[Rig, SignalNote]]:
        """Open a rig for the person, and give it with the note of a signal, which stops the axes first."""
        load_bar()
        with (
            note_signals() as note,
            open_rig(
                rig,
                seed=seed,
                person=TerminalOperator(note, sys.stdin),
                interrupted=note,
                doing=doing,
                opening=opening or Opening(),
                alert=say,
            ) as opened,
        ):
            yield opened, note
        note.insist()  # a request to pause that came too late stops

    @contextmanager
    def take_requests(  # type: ignore[override]
        self, interrupted: SignalNote, run: Path
    ) -> Iterator[PauseRequests]:
        """Take Ctrl+C, if somebody can read what it does and continue the run, and requests of other terminals."""
        at_terminal = sys.stdin.isatty() and sys.stderr.isatty() and not is_in_background(sys.stdin)
        with (
            closing(RunControl(run)) as control,
            interrupted.pausing(enabled=at_terminal and not SPEAKS_JSON.get()),
        ):
            yield _Requests(interrupted, control)

    @contextmanager
    def watch(self) -> Iterator[Callable[[Path], None]]:
        """Show the run in a viewer, if that is asked for, which starts before the rig is opened."""
        try:
            follower = None if self._viewer is None else Follower(self._viewer)
        except OSError as error:
            follower = None
            say(f"live view: it cannot be shown: {error.strerror}")
        if follower is None:
            yield lambda _run: None
            return
        try:
            yield follower.follow
        except BaseException:
            follower.close()
            raise
        follower.finish()
        self._follower = follower

    def leave_view(self) -> None:
        """Leave the view of an ended run open in a browser until Ctrl+C."""
        if self._follower is not None:
            self._follower.stay()


class _Requests(PauseRequests):
    """Requests to pause one run: by Ctrl+C, and by `labrig pause` in another terminal."""

    def __init__(self, note: SignalNote, control: RunControl) -> None:
        self._note = note
        self._control = control
        self._announced = False

    def find(self, point: str) -> str | None:  # noqa: ARG002 - a request is met at any safe point
        """Return by what a pause is asked for."""
        if self._note.asks_for_pause:
            return _BY_KEY
        return _BY_COMMAND if self._control.asks_for_pause else None

    def announce(self, when: str) -> None:
        """Say at the terminal, once for each request, when the pause will begin."""
        by = self.find("")
        if by is not None and not self._announced:
            say(f"{by}: pausing {when}" + ("; Ctrl+C again stops now" if by == _BY_KEY else ""))
        self._announced = by is not None

    def begin(self) -> None:
        """Note that the pause has begun: the next Ctrl+C is a new request."""
        self._announced = self._note.asks_for_pause = False
        self._control.note(paused=True)

    def find_continuation(self) -> str | None:
        """Return that `labrig continue` was called."""
        if not self._control.asks_to_continue:
            return None
        say("labrig continue: the run goes on")
        return "labrig continue"

    def end(self) -> None:
        """Note that the run continues."""
        self._control.note(paused=False)
