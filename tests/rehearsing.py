"""A rehearsal as two people have it: a labrig that serves the rig, another that runs, a hand and a keyboard."""

import fcntl
import os
import re
import shutil
import socket
import subprocess
import sys
import termios
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[1]
PATIENCE_S = 240.0
PATIENT = {
    "  bitrate: 1000000\n": "  bitrate: 1000000\n  answer_timeout_ms: 5000\n  heartbeat: {timeout_ms: 10000}\n",
    "limits: [-1, 50]": "limits: [-1, 18]",
}
"""The drives wait longer than by default for a labrig on a machine that is busy with something else, and the linear
module is shorter, so that it takes less time from limit to limit."""

_QUESTION = re.compile(r">> (.*?)\n +[^\n]*or no to stop:", re.DOTALL)
_ESCAPES = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]|\r")


_BY_HAND = {
    r"Mount needle (\S+) in": r"needle \1",
    r"Place (?:specimen|block) (.+) \(([\d.]+) % gelatin\)": r"specimen '\1' \2",
    r"Shift specimen .+ to hole (\d+), ([\d.]+) mm": r"hole \1 \2",
    r"Hold the chessboard \((\d+) x (\d+) corners, ([\d.]+) mm .+ view (\d+) of": r"board \4 \1 \2 \3",
    r"Lay the graph paper \(([\d.]+) mm": r"paper \1",
    r"Take away": "clear",
}
"""What labrig asks for, and the line that does it."""


@dataclass(frozen=True)
class Ended:
    """A command that has ended: its exit code, and what its terminal showed."""

    exit_code: int
    shown: str


class ServingRig:
    """A running `labrig devices simulate --rig`."""

    def __init__(self, folder: Path, process: "subprocess.Popen[str]") -> None:
        self.rig = folder / "rig-rehearsal.yaml"
        self.process = process

    def does(self, line: str) -> str:
        """Do something by hand, and return what is said of it."""
        assert self.process.stdin is not None
        assert self.process.stderr is not None
        self.process.stdin.write(line + "\n")
        self.process.stdin.flush()
        return self.process.stderr.readline().strip()

    def obeys(self, question: str) -> str:
        """Do by hand what a question asks for, and return what is typed then."""
        if found := re.search(r"Type the reading of the axis (\w+) in", question):
            return self.does(f"scale {found[1]}").rpartition(": ")[2]
        for pattern, line in _BY_HAND.items():
            if found := re.match(pattern, question):
                assert self.does(found.expand(line)) == f"done: {found.expand(line)}"
        return "yes"

    def run(
        self,
        *arguments: object,
        answer: Callable[[str], str],
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


def free_port() -> int:
    """Return a TCP port that nobody uses now."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        return int(server.getsockname()[1])


def copy_rig(folder: Path, replacements: Mapping[str, str] = PATIENT) -> Path:
    """Return a rehearsal's rig file in a copy of the calibration folder, with ports of its own."""
    shutil.copytree(ROOT / "calibration", folder, dirs_exist_ok=True)
    rig = folder / "rig-rehearsal.yaml"
    text = rig.read_text(encoding="utf-8")
    for port in ("29536", "29537"):
        assert port in text
        text = text.replace(port, str(free_port()))
    for old, new in replacements.items():
        assert old in text
        text = text.replace(old, new, 1)
    rig.write_text(text, encoding="utf-8")
    return rig


@contextmanager
def serve_rehearsal(
    folder: Path, *options: str, replacements: Mapping[str, str] = PATIENT
) -> Iterator[ServingRig]:
    """Serve a rig until the block is left."""
    rig = copy_rig(folder, replacements)
    command = [sys.executable, "-m", "labrig", "devices", "simulate", "--rig", str(rig), *options]
    with subprocess.Popen(
        command, cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        try:
            assert process.stdout is not None
            assert process.stderr is not None
            assert process.stdout.readline().startswith("ready: "), process.stderr.read()
            process.stderr.readline()
            yield ServingRig(folder, process)
        finally:
            process.terminate()
