"""`--live`: a process beside the run shows it; whatever happens to that costs the run nothing."""

import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from threading import Thread

from labrig.cli.options import LiveKind
from labrig.cli.output import say
from labrig.cli.signals import Interruption

# What the viewer has not drawn by then is left to view.rrd.
_DRAWN_WITHIN_S = 10.0


class LiveFollower:
    """The process that shows a run, and the thread that passes on what it says.

    Parameters
    ----------
    command : sequence of str
        Starts the process; it writes sentences on standard output.
    """

    def __init__(self, command: tuple[str, ...]) -> None:
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

    def finish(self, within_s: float = _DRAWN_WITHIN_S) -> None:
        """Wait until the ended run is drawn, but not for long, and report a process that failed."""
        try:
            status = self._process.wait(within_s)
        except (subprocess.TimeoutExpired, Interruption):
            # Whoever interrupts here is tired of waiting. How the run ended is still to be told.
            self._process.kill()
            self._process.wait()
            say("live view: it was ended before all was drawn; view.rrd has the whole run")
        else:
            if status:
                say(f"live view: it ended with status {status}; view.rrd has the whole run")
        self._listener.join()
        if self._process.stdout is not None:
            self._process.stdout.close()

    def _pass_on(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            say(f"live view: {line.rstrip()}")


@contextmanager
def live_view(kind: LiveKind | None) -> Iterator[Callable[[Path], None]]:
    """Give the call that shows a run from when its record is open; without a kind it does nothing."""
    followers: list[LiveFollower] = []

    def watch(path: Path) -> None:
        if kind is None:
            return
        command = (sys.executable, "-m", "labrig.cli.live_follower", str(path.absolute()), kind)
        with suppress(OSError):
            followers.append(LiveFollower(command))

    try:
        yield watch
    finally:
        for follower in followers:
            follower.finish()
