"""A recorded rig in real time while 16 other processes keep every core busy: beats, answers, and what trips.

``python -m tests.benchmarks load`` takes a minute; ``python -m tests.benchmarks.load 300`` five minutes. labrig and the
load are of one priority, ten below that of the process that serves the drives: a drive has a processor of its own.
"""

import os
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path

from labrig.devices.rig import Rig
from labrig.errors import MachineError
from labrig.posix import count_usable_cores
from labrig.record.check import check_run
from labrig.record.reader import CanFrame, Run, open_run
from labrig.runner.supervised_record import begin_session
from tests.benchmarks.can_load import open_served_rig
from tests.benchmarks.table import print_rows
from tests.record.runs import ENDED, begin

DURATION_S = 60.0
PROCESSES = 16
_PRIORITY = 10
_FROM_MM, _TO_MM, _SPEED_MM_S = 0.0, 20.0, 5.0
_BEAT = 0x77F


def print_table(duration_s: float = DURATION_S) -> None:
    """Move the needle to and fro under load, and print what the record says."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        with _keep_cores_busy(), open_served_rig("udp_multicast") as rig:
            os.nice(_PRIORITY)
            ended = _move_to_and_fro(rig, folder, duration_s)
        figures = _read_figures(open_run(folder / "run"))
    what = f"{duration_s:.0f} s, {PROCESSES} other processes on {count_usable_cores()} cores"
    print_rows((what, "measured", "limit"), [["ended", ended, "-"], *figures])


def _read_figures(run: Run) -> list[list[object]]:
    """Return what the record says of beats, answers and trips."""
    frames = list(run.can_frames)
    beats_s = [frame.t_s for frame in frames if frame.can_id == _BEAT]
    return [
        ["drives that tripped", sum(0x80 < frame.can_id < 0x100 for frame in frames), 0],
        ["longest time between two beats, ms", _most_ms(b - a for a, b in pairwise(beats_s)), 500],
        ["longest wait for an answer, ms", _most_ms(_waits_s(frames)), 120],
        ["states recorded", len(run.states), "-"],
        ["record sound", not check_run(run.path).damage, True],
    ]


@contextmanager
def _keep_cores_busy() -> Iterator[None]:
    command = ["nice", "-n", str(_PRIORITY), sys.executable, "-c", "while True: pass"]
    processes = [subprocess.Popen(command) for _ in range(PROCESSES)]
    try:
        yield
    finally:
        for process in processes:
            process.kill()
            process.wait()


def _move_to_and_fro(rig: Rig, folder: Path, duration_s: float) -> str:
    """Move the needle until the time is over or something trips; return how it ended."""
    session = begin_session(rig, lambda: begin(folder), lambda _done, _doing: None)
    until_s, ends_mm = rig.clock.now_s() + duration_s, [_TO_MM, _FROM_MM]
    ended = "as planned"
    try:
        while rig.clock.now_s() < until_s:
            session.move("insertion", ends_mm[0], _SPEED_MM_S)
            ends_mm.reverse()
        rig.end()
    except MachineError as error:
        ended = error.message
    session.recorder.close("success" if ended == "as planned" else "failed", "", ENDED)
    return ended


def _waits_s(frames: Iterable[CanFrame]) -> Iterator[float]:
    """Yield how long each answer of a drive took [s]."""
    asked_s: dict[int, float] = {}
    for frame in frames:
        node = frame.can_id & 0x7F
        if frame.way == "T" and 0x600 < frame.can_id < 0x680:
            asked_s[node] = frame.t_s
        elif 0x580 < frame.can_id < 0x600 and node in asked_s:
            yield frame.t_s - asked_s.pop(node)


def _most_ms(durations_s: Iterable[float]) -> str:
    return f"{1000 * max(durations_s):.0f}"


if __name__ == "__main__":
    print_table(*map(float, sys.argv[1:]))
