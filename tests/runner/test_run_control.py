"""Requests from another terminal to a run that is being made."""

import json
import os
import socket
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from labrig.errors import InputError, RecordError
from labrig.record.check import check_run
from labrig.record.writer import Recorder
from labrig.runner.run_control import Order, RunControl, ask_run
from tests.record.runs import ENDED, begin


@pytest.fixture
def recorder(tmp_path: Path) -> Iterator[Recorder]:
    """A run that is being made, by this process."""
    recorder = begin(tmp_path)
    yield recorder
    recorder.close("aborted", "", ENDED)


def ask(run: Path, control: RunControl, order: Order, *, paused: bool) -> str:
    """Ask from another thread, while the run looks for requests; return the answer, also a refusal."""
    answers: list[str] = []

    def call() -> None:
        try:
            answers.append(ask_run(run, order))
        except InputError as error:
            answers.append(error.message)

    caller = threading.Thread(target=call)
    caller.start()
    while caller.is_alive():
        control.poll("after this insertion", paused=paused)
    return answers[0]


def test_a_run_is_paused_and_continued_from_elsewhere(recorder: Recorder) -> None:
    """The answer says when it pauses; a pause can be taken back; continuing what is not paused is refused."""
    run, control = recorder.path, RunControl(recorder.path)
    assert ask(run, control, "continue", paused=False).endswith("the run is not paused")
    assert ask(run, control, "pause", paused=False) == "the run pauses after this insertion"
    assert control.asks_for_pause
    assert ask(run, control, "continue", paused=False) == "the pause that was asked for is taken back"
    assert not control.asks_for_pause
    assert ask(run, control, "pause", paused=True) == "the run is paused already"
    assert ask(run, control, "continue", paused=True) == "the run continues"
    assert control.asks_to_continue
    control.close()
    assert not (run / ".control").exists()


def test_a_run_that_is_over_or_elsewhere_is_refused(recorder: Recorder, tmp_path: Path) -> None:
    """So is one that takes no requests, and one whose socket is a link out of its folder."""
    run = recorder.path
    with pytest.raises(InputError, match="takes no requests"):
        ask_run(run, "pause")
    outside = tmp_path / "outside.socket"
    with socket.socket(socket.AF_UNIX) as listening:
        listening.bind(str(outside))
        listening.listen()
        (run / ".control").symlink_to(outside)
        with pytest.raises(RecordError, match="symbolic link"):
            ask_run(run, "pause")
        (run / ".control").unlink()
    lock = json.loads((run / ".lock.owner").read_text())
    (run / ".lock.owner").write_text(json.dumps({**lock, "host": "elsewhere"}))
    with pytest.raises(InputError, match=r"is made on elsewhere, and this is "):
        ask_run(run, "pause")
    recorder.close("success", "", ENDED)
    with pytest.raises(InputError, match=r"is not being made: it has ended: success"):
        ask_run(run, "continue")


def test_the_socket_that_a_killed_run_leaves_is_no_damage_and_is_replaced(recorder: Recorder) -> None:
    """A second labrig that resumes the run listens at the same place."""
    left = RunControl(recorder.path)
    assert left._listener is not None
    left._listener._socket.close()
    assert check_run(recorder.path).damage == ()
    with pytest.raises(InputError, match="takes no requests"):
        ask_run(recorder.path, "pause")
    again = RunControl(recorder.path)
    assert ask(recorder.path, again, "pause", paused=False) == "the run pauses after this insertion"
    again.close()


def test_a_caller_that_says_nothing_holds_nobody_up(recorder: Recorder) -> None:
    """Silent callers, and lines that are no requests, are answered or dropped; the run never waits for them."""
    control = RunControl(recorder.path)
    silent = [socket.socket(socket.AF_UNIX) for _ in range(20)]
    folder = os.open(recorder.path, os.O_RDONLY)
    for caller in silent:
        caller.setblocking(False)
        try:
            caller.connect(f"/proc/self/fd/{folder}/.control")
        except BlockingIOError:
            break
        control.poll("", paused=False)
    os.close(folder)
    for caller in silent:
        caller.close()
    assert ask(recorder.path, control, "pause", paused=False) == "the run pauses after this insertion"
    control.close()
