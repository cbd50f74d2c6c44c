"""`labrig pause` and `labrig continue`, while a run looks for requests."""

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from labrig.cli.pausing import RunRequests, take_requests
from labrig.cli.signals import SignalNote
from tests.cli.conftest import Labrig
from tests.record.runs import ENDED, begin


@contextmanager
def _looking(look: Callable[[], object]) -> Iterator[None]:
    """Look for requests again and again during the block, as a run does."""
    over = threading.Event()

    def run() -> None:
        while not over.is_set():
            look()

    looking = threading.Thread(target=run)
    looking.start()
    try:
        yield
    finally:
        over.set()
        looking.join()


def test_a_run_is_paused_and_continued_by_commands(labrig: Labrig, tmp_path: Path) -> None:
    """`pause` says when it begins, `continue` ends it; a run that is not paused, or over, exits with 2."""
    recorder, note = begin(tmp_path), SignalNote()
    with take_requests(note, recorder.path) as requests:
        with _looking(lambda: requests.announce("after this insertion")):
            done = labrig("pause", recorder.path, "--json")
            assert (done.exit_code, done.json()["answer"]) == (0, "the run pauses after this insertion")
            assert requests.find("trial_end") == "labrig pause"
        _pause_and_continue(requests, labrig, recorder.path)
        with _looking(lambda: requests.announce("")):
            refused = labrig("continue", recorder.path)
        assert (refused.exit_code, "the run is not paused" in refused.err) == (2, True)
    recorder.close("success", "", ENDED)
    over = labrig("pause", recorder.path, "--json")
    assert (over.exit_code, over.json()["error"]["type"]) == (2, "InputError")
    assert labrig("pause", tmp_path).exit_code == 4


def _pause_and_continue(requests: RunRequests, labrig: Labrig, run: Path) -> None:
    requests.begin()
    found: list[str | None] = []
    with _looking(lambda: found.append(requests.find_continuation())):
        done = labrig("continue", run)
    assert (done.exit_code, done.out) == (0, "the run continues\n")
    assert "labrig continue" in found
    requests.end()
    assert requests.find("question") is None


def test_ctrl_c_is_announced_once_and_met_by_a_pause(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The request stands until the pause begins; the next Ctrl+C is a new one."""
    recorder, note = begin(tmp_path), SignalNote(lambda: True)
    with take_requests(note, recorder.path) as requests:
        for _ in range(2):
            note.take(2, None)
            assert requests.find("trial_end") == "Ctrl+C"
            requests.announce("after this insertion")
            requests.announce("after this insertion")
            requests.begin()
            assert requests.find("trial_end") is None
            requests.end()
            assert capsys.readouterr().err.count("Ctrl+C: pausing after this insertion; Ctrl+C again") == 1
    recorder.close("success", "", ENDED)
