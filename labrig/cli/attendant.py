"""The person at the terminal attends a run."""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path

from labrig.cli.live import show_while_made
from labrig.cli.options import LiveKind
from labrig.cli.output import say
from labrig.cli.pausing import RunRequests, take_requests
from labrig.cli.progress import Reporter, progress
from labrig.cli.rigs import open_rig_for_person
from labrig.cli.signals import SignalNote
from labrig.devices.opening import Opening
from labrig.devices.rig import Rig
from labrig.devices.rig_file import RigDescription
from labrig.runner.attendant import Attendant


class TerminalAttendant(Attendant):
    """Talks on standard error, asks at the terminal, and is interrupted by signals.

    Parameters
    ----------
    pauses : bool
        Whether the person may pause the run, and is called by the bell.
    viewer : str or None
        How the run is shown while it is made.
    """

    def __init__(self, viewer: LiveKind | None = None, *, pauses: bool = False) -> None:
        self._pauses = pauses
        self._viewer = viewer

    def say(self, text: str) -> None:
        """Tell what happens."""
        say(text)

    def progress(self, title: str, total: float) -> AbstractContextManager[Reporter]:  # type: ignore[override]
        """Show how much of the total is done."""
        return progress(title, total)

    @contextmanager
    def open_rig(  # the note of a signal is what pauses ask, too
        self, rig: RigDescription, doing: str, seed: int, opening: Opening
    ) -> Iterator[tuple[Rig, SignalNote]]:
        """Open a rig for the person, and give the note of a signal."""
        with open_rig_for_person(rig, doing, seed=seed, opening=opening, pauses=self._pauses) as (
            opened,
            note,
        ):
            yield opened, note
        # A request to pause that came too late stops.
        note.insist()

    def take_requests(  # type: ignore[override]
        self, interrupted: SignalNote, run: Path
    ) -> AbstractContextManager[RunRequests]:
        """Take Ctrl+C, and the requests of other terminals."""
        return take_requests(interrupted, run)

    def watch(self) -> AbstractContextManager[Callable[[Path], None]]:  # type: ignore[override]
        """Show the run in a viewer, if that is asked for."""
        return show_while_made(self._viewer)
