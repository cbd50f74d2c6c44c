"""`--live` and `--verbose`: processes beside the run show it or tell its events; they cost the run nothing."""

import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from threading import Thread

from labrig.cli.options import LiveKind
from labrig.cli.output import say
from labrig.cli.signals import Interruption
from labrig.record.layout import EVENT_LINES

# What has not been shown by then is left out.
_SHOWN_WITHIN_S = 10.0


@dataclass(frozen=True)
class Watching:
    """How a run is shown while it is made: by a viewer of this kind, and by a log of its events on the terminal."""

    viewer: LiveKind | None = None
    log: bool = False


UNWATCHED = Watching()


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
def show_while_made(watching: Watching) -> Iterator[Callable[[Path], None]]:
    """Give the call that shows a run from when its record is open; unwatched it does nothing."""
    followers: list[Follower] = []

    def watch(path: Path) -> None:
        with suppress(OSError):
            if watching.log:
                followers.append(_follow_log(path))
            if watching.viewer is not None:
                followers.append(follow_in_viewer(path, watching.viewer))

    try:
        yield watch
    finally:
        for follower in followers:
            follower.finish()


def follow_in_viewer(path: Path, kind: LiveKind, *program: str) -> Follower:
    """Show a run in the viewer; `program` starts another one than rerun's."""
    command = (sys.executable, "-m", "labrig.cli.live_follower", str(path.absolute()), kind, *program)
    return Follower(command, "live view: ", "view.rrd")


def _follow_log(path: Path) -> Follower:
    """Tell the events from now on; a resumed run has earlier ones."""
    told = (path / EVENT_LINES).read_bytes().count(b"\n")
    command = (
        sys.executable,
        "-m",
        "labrig",
        "runs",
        "log",
        str(path.absolute()),
        "--follow",
        f"--skip={told}",
    )
    return Follower(command, "", "labrig runs log")
