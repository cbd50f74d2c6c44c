"""Whatever stops a writer: nothing that was acknowledged is lost, and the run can be read, continued and closed."""

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest

from labrig.errors import DiskError, RecordError
from labrig.record.check import check_run
from labrig.record.reader import open_run
from labrig.record.writer import Recorder, reopen_run
from tests.record.runs import CAN_FRAMES, ENDED, begin, picture

pytestmark = pytest.mark.slow

CALLS = ("write", "replace", "rename", "fsync", "ftruncate", "posix_fallocate", "mkdir", "open")


class Cut(BaseException):
    """The power goes: nothing after it happens."""


@contextmanager
def failing(monkeypatch: pytest.MonkeyPatch, number: int, failure: BaseException) -> Iterator[list[str]]:
    """Let the n-th call of the operating system that changes the disk fail; a cut also fails all that follow."""
    told: list[str] = []

    def count(name: str, call: object) -> object:
        def counted(*arguments: object, **options: object) -> object:
            told.append(name)
            if len(told) == number or (len(told) > number and isinstance(failure, Cut)):
                raise failure
            return call(*arguments, **options)  # type: ignore[operator]

        return counted

    with monkeypatch.context() as patch:
        for name in CALLS:
            patch.setattr(os, name, count(name, getattr(os, name)))
        yield told


def record(runs_dir: Path, acknowledged: list[str]) -> Recorder:
    """Record a little of everything, and note each call that has returned."""
    recorder = begin(runs_dir)
    for number in range(2):
        recorder.event("trial_start", 2.0 * number, trial=number)
        acknowledged.append("event")
        recorder.state(2.0 * number, insertion_mm=1.0)
        acknowledged.append("state")
        recorder.frame(picture(number), 2.0 * number + 1, trial=number)
        acknowledged.append("frame")
        recorder.truth(trial=number)
        recorder.can_frames(CAN_FRAMES)
        recorder.event("trial_stop", 2.0 * number + 1.5, trial=number, exit_status="success")
        acknowledged.append("event")
    return recorder


def assert_holds(run: Path, acknowledged: list[str]) -> None:
    """Everything acknowledged can be read, and at most one of each kind more, which was under way."""
    opened = open_run(run)
    assert opened.damage == ()
    held = {"event": len(opened.events), "state": len(opened.states), "frame": len(list(opened.pictures))}
    for kind, count in held.items():
        assert acknowledged.count(kind) <= count <= acknowledged.count(kind) + 1


def count_calls(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> int:
    """Return how many calls a whole run makes."""
    with failing(monkeypatch, 0, OSError()) as told:
        record(tmp_path / "counted", []).close("success", "", ENDED)
    return len(told)


@pytest.mark.parametrize("failure", [Cut(), OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))])
def test_a_cut_or_a_full_disk_at_any_call_loses_nothing_acknowledged(tmp_path, monkeypatch, failure):
    """After it the run is none yet, or can be read, continued from there, and closed; a refused call is told."""
    cut = isinstance(failure, Cut)
    for number in range(1, count_calls(tmp_path, monkeypatch) + 1):
        runs_dir, acknowledged = tmp_path / str(number), list[str]()
        told_of = (Cut,) if cut else (DiskError, RecordError)
        with failing(monkeypatch, number, failure) as called, suppress(*told_of):
            record(runs_dir, acknowledged).close("success", "", ENDED)
            # A run on a busy computer may make a call more or less than the counted one.
            assert not cut or len(called) < number
        run = runs_dir / "run"
        if not (run / "manifest.json").exists():
            assert not acknowledged
            assert cut or not run.exists()
            continue
        assert_holds(run, acknowledged)
        if open_run(run).manifest["exit_status"] == "incomplete":
            (run / ".lock").unlink(missing_ok=True)  # the process that held it is gone
            again = reopen_run(run, "labrig resume")
            again.frame(picture(9), 1.0, trial=2)
            again.close("success", "", ENDED)
        found = check_run(run)
        assert found.damage == ()
        assert not cut or found.notices == (), number
        assert not cut or not [path for path in run.rglob(".*") if path.suffix == ".tmp"]


def test_a_torn_last_line_is_dropped(tmp_path):
    """By every reader; a run that goes on continues behind the last whole line."""
    recorder = record(tmp_path, [])
    for name in ("events.jsonl", "states.jsonl", "frames.jsonl", "truth.jsonl"):
        content = (recorder.path / name).read_bytes()
        for torn in range(content[:-1].rfind(b"\n") + 2, len(content)):
            (recorder.path / name).write_bytes(content[:torn])
            lines = open_run(recorder.path).lines(name.removesuffix(".jsonl"))
            assert len(lines) == content.count(b"\n") - 1
        (recorder.path / name).write_bytes(content)
    with (recorder.path / "events.jsonl").open("ab") as events:
        events.write(b'{"kind":"no')
    recorder._lock.release()
    again = reopen_run(recorder.path, "labrig resume")
    again.event("note", 0.5, text="after")
    again.close("success", "", ENDED)
    run = open_run(recorder.path)
    assert [line["kind"] for line in run.lines("events")][-2:] == ["trial_stop", "note"]
    assert run.lines("events")[-1]["t_s"] == 4.5
    assert check_run(recorder.path).damage == ()
