"""fsyncs by a thread of its own: what is durable when, and what happens when the disk is slow or refuses."""

from collections.abc import Callable
from pathlib import Path
from threading import Event
from typing import Any, Self

import pytest

from labrig.record.rounds import Rounds
from labrig.record.writer import Recorder
from tests.record.runs import begin


class Disk:
    """Pictures and their lines, as many as were written and as many as are durable."""

    def __init__(self) -> None:
        self.written = {"pictures": 0, "lines": 0}
        self.durable = {"pictures": 0, "lines": 0}
        self.meanwhile: Callable[[], None] = lambda: None

    def take(self) -> None:
        """Write a picture, then its line."""
        self.written["pictures"] += 1
        self.written["lines"] += 1


class Part:
    """Its pictures, or its lines."""

    def __init__(self, disk: Disk, name: str) -> None:
        self.disk, self.name = disk, name

    def sync(self) -> None:
        """Make what was written before durable; `meanwhile` happens while the disk is at it."""
        reached = self.disk.written[self.name]
        self.disk.meanwhile()
        self.disk.durable[self.name] = reached


class Latch:
    """A round that lasts until it is let go."""

    def __init__(self) -> None:
        self._go, self.done = Event(), 0

    def __call__(self) -> None:
        """Wait, then count."""
        assert self._go.wait(60.0)
        self.done += 1

    def let_go(self) -> Self:
        """End it, or let it end as soon as it begins."""
        self._go.set()
        return self


def record_on(disk: Disk, runs_dir: Path) -> Recorder:
    """Return the record of a run on a disk that tells what is durable."""
    recorder: Any = begin(runs_dir)
    recorder._pictures = Part(disk, "pictures")
    recorder._lines = {name: Part(disk, "lines") for name in ("states.jsonl", "frames.jsonl", "can.log")}
    return recorder


def test_no_line_is_durable_before_its_picture(tmp_path: Path) -> None:
    """Pictures that come while the disk is at it wait for the next round with their lines, or are durable first."""
    disk = Disk()
    recorder = record_on(disk, tmp_path)

    def camera() -> None:
        if not recorder._appending.locked():
            disk.take()

    disk.take()
    disk.meanwhile = camera
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


def test_a_round_that_is_due_during_another_is_left_out() -> None:
    """A caller does not wait for a slow disk."""
    rounds, slow, left_out, next_one = Rounds(most_behind=10), Latch(), Latch(), Latch()
    rounds.begin(slow)
    rounds.begin(left_out)
    slow.let_go()
    rounds.finish()
    rounds.begin(next_one.let_go())
    rounds.finish()
    rounds.close()
    assert (slow.done, left_out.done, next_one.done) == (1, 0, 1)


def test_a_caller_waits_once_the_disk_is_too_far_behind() -> None:
    """The round that must not be left out begins when the slow one has ended."""
    rounds, slow, last = Rounds(most_behind=1), Latch(), Latch()
    rounds.begin(slow)
    slow.let_go()
    rounds.begin(last.let_go())
    done_before_the_last = slow.done
    rounds.finish()
    rounds.close()
    assert (done_before_the_last, last.done) == (1, 1)


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
