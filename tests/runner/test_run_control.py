"""Requests from another terminal to a run that is being made."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from labrig.errors import InputError, RecordError
from labrig.record.check import check_run
from labrig.record.writer import Recorder
from labrig.runner.run_control import RunControl, ask_run
from tests.record.runs import ENDED, begin


@pytest.fixture
def recorder(tmp_path: Path) -> Iterator[Recorder]:
    """A run that is being made, by this process."""
    recorder = begin(tmp_path)
    yield recorder
    recorder.close("aborted", "", ENDED)


def test_a_run_is_paused_and_continued_from_elsewhere(recorder: Recorder) -> None:
    """What a killed run has left asks for nothing; a pause stands until it is to end, and its file is no damage."""
    run = recorder.path
    (run / ".control").write_bytes(b"pause")
    control = RunControl(run)
    assert (control.asks_for_pause, check_run(run).damage) == (False, ())
    for _ in range(2):
        assert ask_run(run, "pause").startswith("the run pauses at its next safe point")
        assert control.asks_for_pause
    control.note(paused=True)
    assert (control.asks_for_pause, control.asks_to_continue) == (True, False)
    assert ask_run(run, "continue") == "the run continues"
    assert (control.asks_for_pause, control.asks_to_continue) == (False, True)
    with pytest.raises(InputError, match="the run is not paused"):
        ask_run(run, "continue")
    control.close()
    assert not (run / ".control").exists()
    assert not control.asks_to_continue


def test_a_run_that_is_over_or_takes_no_requests_is_refused(recorder: Recorder, tmp_path: Path) -> None:
    """So is one whose file is a link out of its folder."""
    run, outside = recorder.path, tmp_path / "outside"
    with pytest.raises(InputError, match="takes no requests"):
        ask_run(run, "pause")
    outside.write_text("running")
    (run / ".control").symlink_to(outside)
    with pytest.raises(RecordError, match="symbolic link"):
        ask_run(run, "pause")
    (run / ".control").unlink()
    recorder.close("success", "", ENDED)
    with pytest.raises(InputError, match=r"is not being made: it has ended: success"):
        ask_run(run, "continue")
    assert outside.read_text() == "running"
