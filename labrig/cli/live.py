"""`--live`: a process beside the run shows it; it costs the run nothing."""

import subprocess
import sys
from contextlib import suppress
from pathlib import Path
from threading import Event, Thread

from labrig.cli.options import LiveKind
from labrig.cli.output import COMMAND, say
from labrig.cli.signals import Interruption

# What has not been shown by then is left out.
_SHOWN_WITHIN_S = 10.0
# A viewer that starts tells where it is by then; one that serves a browser ends no sooner than after the second.
_TELLS_WITHIN_S, _ENDS_WITHIN_S = 30.0, 1.0


class Follower:
    """The process that shows a run, and the thread that passes on what it says.

    Its viewer has started, and a person knows where, when this is made. In a browser it stays until `close`.

    Parameters
    ----------
    kind : str
        How the run is shown.
    program : str
        Another viewer than rerun's.
    """

    def __init__(self, kind: LiveKind, *program: str) -> None:
        self._process = subprocess.Popen(  # noqa: S603 - this Python with a module of labrig
            (sys.executable, "-m", "labrig.cli.live_follower", kind, *program),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            # Warnings of the viewer's library, which nobody could act on.
            stderr=subprocess.DEVNULL,
            text=True,
            errors="replace",
            start_new_session=True,
        )
        self._told = Event()
        self._listener = Thread(target=self._pass_on, daemon=True)
        self._listener.start()
        self._told.wait(_TELLS_WITHIN_S)

    def follow(self, run: Path) -> None:
        """Show a run from when its record is open."""
        assert self._process.stdin is not None
        with suppress(BrokenPipeError):  # it has said why it ended
            self._process.stdin.write(f"{run.absolute()}\n")
            self._process.stdin.flush()

    def finish(self, within_s: float = _SHOWN_WITHIN_S) -> None:
        """Wait until the ended run is shown, but not for long, and report a process that failed."""
        problem = "it was ended before all was shown"
        try:
            # Whoever interrupts here is tired of waiting. How the run ended is still to be told.
            with suppress(Interruption):
                self._listener.join(within_s)
                if not self._listener.is_alive():
                    status = self._process.wait(_ENDS_WITHIN_S)
                    problem = f"it ended with status {status}" if status else ""
        except subprocess.TimeoutExpired:
            return  # a browser shows it
        self.close()
        if problem:
            say(f"live view: {problem}; view.rrd has the whole run")

    def stay(self) -> None:
        """Leave the view open in a browser until Ctrl+C."""
        if self._process.poll() is not None:
            return
        with suppress(Interruption):
            say("live view: it stays open until Ctrl+C")
            self._process.wait()
        self.close()

    def close(self) -> None:
        """End the process."""
        self._process.kill()
        self._listener.join()
        # Its input is closed too, and may hold what it no longer took.
        with suppress(BrokenPipeError), self._process:
            pass

    def _pass_on(self) -> None:
        assert self._process.stdout is not None
        with self._process.stdout as said:
            for line in said:
                say(line.rstrip() if line.startswith(COMMAND) else f"live view: {line.rstrip()}")
                self._told.set()
        self._told.set()
