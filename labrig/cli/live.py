"""`--live`: a process beside the run shows it; it costs the run nothing."""

import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import Thread

from labrig.cli.options import LiveKind
from labrig.cli.output import say
from labrig.cli.signals import Interruption

# What has not been shown by then is left out.
_SHOWN_WITHIN_S = 10.0


class Follower:
    """The process that shows a run, and the thread that passes on what it says.

    Parameters
    ----------
    command : tuple of str
        Starts the process; it writes sentences on standard output.
    title : str
        Stands before each of them.
    whole : str
        Where the whole run can be read.
    """

    def __init__(self, command: tuple[str, ...], title: str, whole: str) -> None:
        self._title, self._whole = title, whole
        self._process = subprocess.Popen(  # noqa: S603 - this Python with a module of labrig, and a folder
            command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            # Warnings of the viewer's library, which nobody could act on.
            stderr=subprocess.DEVNULL,
            text=True,
            errors="replace",
            start_new_session=True,
        )
        self._listener = Thread(target=self._pass_on, daemon=True)
        self._listener.start()

    def finish(self, within_s: float = _SHOWN_WITHIN_S) -> None:
        """Wait until the ended run is shown, but not for long, and report a process that failed."""
        try:
            status = self._process.wait(within_s)
        except (subprocess.TimeoutExpired, Interruption):
            # Whoever interrupts here is tired of waiting. How the run ended is still to be told.
            self._process.kill()
            self._process.wait()
            say(f"{self._title}it was ended before all was shown; {self._whole} has the whole run")
        else:
            if status:
                say(f"{self._title}it ended with status {status}; {self._whole} has the whole run")
        self._listener.join()
        if self._process.stdout is not None:
            self._process.stdout.close()

    def _pass_on(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            say(f"{self._title}{line.rstrip()}")


@contextmanager
def show_while_made(viewer: LiveKind | None) -> Iterator[Callable[[Path], None]]:
    """Give the call that shows a run from when its record is open; without a viewer it does nothing."""
    followers: list[Follower] = []

    def watch(path: Path) -> None:
        if viewer is not None:
            try:
                followers.append(follow_in_viewer(path, viewer))
            except OSError as error:
                say(f"live view: it cannot be shown: {error.strerror}")

    try:
        yield watch
    finally:
        for follower in followers:
            follower.finish()


def follow_in_viewer(path: Path, kind: LiveKind, *program: str) -> Follower:
    """Show a run in the viewer; `program` starts another one than rerun's."""
    command = (sys.executable, "-m", "labrig.cli.live_follower", str(path.absolute()), kind, *program)
    return Follower(command, "live view: ", "view.rrd")
