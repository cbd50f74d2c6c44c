"""`--live`: a process beside the run shows it; it costs the run nothing."""

import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
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
    run : Path
        Its folder.
    kind : str
        How it is shown.
    program : str
        Another viewer than rerun's.
    """

    def __init__(self, run: Path, kind: LiveKind, *program: str) -> None:
        self._process = subprocess.Popen(  # noqa: S603 - this Python with a module of labrig, and a folder
            (sys.executable, "-m", "labrig.cli.live_follower", str(run.absolute()), kind, *program),
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
            problem = f"it ended with status {status}" if status else ""
        except (subprocess.TimeoutExpired, Interruption):
            # Whoever interrupts here is tired of waiting. How the run ended is still to be told.
            self._process.kill()
            self._process.wait()
            problem = "it was ended before all was shown"
        self._listener.join()
        if problem:
            say(f"live view: {problem}; view.rrd has the whole run")

    def _pass_on(self) -> None:
        assert self._process.stdout is not None
        with self._process.stdout as said:
            for line in said:
                say(f"live view: {line.rstrip()}")


@contextmanager
def show_while_made(kind: LiveKind | None) -> Iterator[Callable[[Path], None]]:
    """Give the call that shows a run from when its record is open; without a kind it does nothing."""
    with ExitStack() as at_the_end:

        def watch(run: Path) -> None:
            if kind is not None:
                try:
                    at_the_end.callback(Follower(run, kind).finish)
                except OSError as error:
                    say(f"live view: it cannot be shown: {error.strerror}")

        yield watch
