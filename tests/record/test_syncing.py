"""fsyncs by a thread of its own: what is durable when, and what happens when the disk is slow or refuses."""

from collections.abc import Callable
from pathlib import Path
from threading import Event
from types import SimpleNamespace
from typing import Any

import pytest

from labrig.record.rounds import Rounds
from labrig.record.writer import Recorder
from tests.record.runs import begin


class Disk:
    """How many pictures with a line each were written, and how many of either are durable."""

    def __init__(self) -> None:
        self.written, self.durable = 0, {"pictures": 0, "lines": 0}
        self.meanwhile: Callable[[], object] = lambda: None

    def part(self, name: str) -> Any:
        """Return its pictures, or its lines; `meanwhile` happens while the disk makes them durable."""

        def sync() -> None:
            reached = self.written
            self.meanwhile()
            self.durable[name] = reached

        return SimpleNamespace(sync=sync)


def record_on(disk: Disk, runs_dir: Path) -> Recorder:
    """Return the record of a run on a disk that tells what is durable."""
    recorder = begin(runs_dir)
    recorder._pictures = disk.part("pictures")
    recorder._lines = {name: disk.part("lines") for name in ("states.jsonl", "frames.jsonl", "can.log")}
    return recorder


def test_no_line_is_durable_before_its_picture(tmp_path: Path) -> None:
    """Pictures that come while the disk is at it wait for the next round with their lines, or are durable first."""
    disk = Disk()
    recorder = record_on(disk, tmp_path)

    def camera() -> None:
        disk.written += not recorder._appending.locked()

    disk.written, disk.meanwhile = 1, camera
    del recorder._lines["can.log"], recorder._lines["states.jsonl"]
    recorder._sync()
    assert disk.durable == {"pictures": 2, "lines": 2}


def test_only_the_lines_of_pictures_wait_for_the_disk(tmp_path: Path) -> None:
    """States, events and CAN frames are appended while theirs or others are being made durable."""
    disk, held = Disk(), list[bool]()
    recorder = record_on(disk, tmp_path)
    disk.meanwhile = lambda: held.append(recorder._appending.locked())
    recorder._sync()
    assert held == [False, True, True, False, False]


@pytest.mark.parametrize(
    ("most_behind", "made"),
    [(10, ["slow", "last"]), (1, ["slow", "due meanwhile", "last"])],
    ids=["left out", "waited for"],
)
def test_a_round_that_is_due_during_another_is_left_out(most_behind: int, made: list[str]) -> None:
    """A caller does not wait for a slow disk, but once it is too far behind; what was left out comes with the next."""
    rounds, go, done = Rounds(most_behind), Event(), list[str]()

    def slow() -> None:
        assert go.wait(60.0)
        done.append("slow")

    rounds.begin(slow)
    if most_behind == 1:
        go.set()  # or the next call would wait for ever
    rounds.begin(lambda: done.append("due meanwhile"))
    go.set()
    rounds.finish()
    rounds.begin(lambda: done.append("last"))
    rounds.close()
    assert done == made


def test_what_the_disk_refuses_is_raised_by_the_next_call() -> None:
    """A fault of the disk is not lost with its thread."""
    rounds = Rounds(most_behind=10)

    def refused() -> None:
        raise OSError(5, "Input/output error")

    rounds.begin(refused)
    with pytest.raises(OSError, match="Input/output"):
        rounds.finish()
    rounds.finish()
    rounds.close()
