"""A person at the terminal of a labrig that rehearses: a simulated rig with a real clock, which asks everything."""

import fcntl
import os
import re
import subprocess
import sys
import termios
import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from tests.small_camera import CALIBRATED_SMALL_CAMERA

ROOT = Path(__file__).parents[1]
PATIENCE_S = 240.0
REHEARSED = {
    "rig.clock": "real",
    "rig.can.heartbeat.timeout_ms": 10000,
    "rig.axes.insertion.max_speed": 40,
    "rig.axes.insertion.acceleration": 200,
    "rig.axes.linear.max_speed": 40,
    "rig.axes.linear.acceleration": 200,
    "sheath.speed_mm_s": 30,
    **{f"rig.{key}": value for key, value in (line.split("=", 1) for line in CALIBRATED_SMALL_CAMERA)},
}
"""A small camera with the calibration of the kept records, and quick axes. The drives wait longer than by
default for a labrig on a machine that is busy with something else."""

_QUESTION = re.compile(r">> (.*?)\n +[^\n]*or no to stop:", re.DOTALL)
_ESCAPES = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]|\r")


@dataclass(frozen=True)
class Ended:
    """A command that has ended: its exit code, and what its terminal showed."""

    exit_code: int
    shown: str


def agree(question: str) -> str:
    """Return what somebody types who agrees to everything, and reads what a simulated scale shows."""
    shown = re.search(r"It is simulated and shows (-?[\d.]+)\.( |$)", question)
    return "yes" if shown is None else shown[1]


def run_at_terminal(
    *arguments: object,
    answer: Callable[[str], str] = agree,
    patience_s: float = PATIENCE_S,
    press: Callable[[str], str] = lambda _shown: "",
) -> Ended:
    """Run a labrig in a terminal of its own.

    Parameters
    ----------
    answer : callable
        Returns what is typed at each question.
    press : callable
        Is given all that the terminal has shown whenever it shows more; returns the keys that are pressed then.
    """
    keyboard, screen = os.openpty()
    command = [sys.executable, "-m", "labrig", *map(str, arguments)]
    with subprocess.Popen(
        command,
        cwd=ROOT,
        stdin=screen,
        stdout=screen,
        stderr=screen,
        env={**os.environ, "COLUMNS": "300"},
        start_new_session=True,
        preexec_fn=_take_terminal,  # noqa: PLW1509 - no other thread holds a lock here
    ) as running:
        os.close(screen)
        watchdog = threading.Timer(patience_s, running.kill)
        watchdog.start()
        try:
            shown = _converse(keyboard, answer, press)
        finally:
            watchdog.cancel()
            os.close(keyboard)
        return Ended(running.wait(PATIENCE_S), shown)


def _take_terminal() -> None:
    """Make standard input the terminal that controls this process, so that its Ctrl+C is a signal."""
    fcntl.ioctl(0, termios.TIOCSCTTY, 0)


def _converse(keyboard: int, answer: Callable[[str], str], press: Callable[[str], str]) -> str:
    """Answer each question of a terminal until it closes; return everything that it showed."""
    shown, answered = "", 0
    while True:
        try:
            data = os.read(keyboard, 65536)
        except OSError:  # the last program at the terminal has ended
            return _ESCAPES.sub("", shown)
        shown += data.decode("utf-8", "replace")
        os.write(keyboard, press(_ESCAPES.sub("", shown)).encode())
        questions = _QUESTION.findall(_ESCAPES.sub("", shown))
        for question in questions[answered:]:
            os.write(keyboard, f"{answer(' '.join(question.split()))}\n".encode())
        answered = len(questions)
