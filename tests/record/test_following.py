"""Reading the lines of a record while it is written."""

from pathlib import Path

import numpy as np
import pytest

from labrig.devices.clocks import SimulatedClock
from labrig.errors import RecordError
from labrig.record.following import GrowingRun, list_lines
from labrig.record.reader import open_run
from tests.record.runs import ENDED, begin


def test_each_line_is_read_once_and_a_torn_one_when_it_is_whole(tmp_path: Path) -> None:
    """A follower gets what was added since, never half a line, and knows when nobody writes; no JSON is refused."""
    recorder = begin(tmp_path)
    growing = GrowingRun(recorder.path)
    assert not growing.read_new()
    recorder.event("run_start", 0.0, experiment="steerability")
    recorder.frame(np.full((4, 5), 7, np.uint8), 0.5)
    recorder.state(1.0, insertion_mm=1.0)
    new = growing.read_new()
    assert [event["kind"] for event in new.events] == ["run_start"]
    assert [state["insertion_mm"] for state in new.states] == [1.0]
    assert new.pictures[0].read().tolist() == np.full((4, 5), 7).tolist()
    assert not growing.read_new()

    events = recorder.path / "events.jsonl"
    whole = events.read_bytes()
    events.write_bytes(whole + whole[: len(whole) // 2])
    assert not growing.read_new()
    events.write_bytes(whole + whole)
    assert len(growing.read_new().events) == 1
    events.write_bytes(whole.replace(b"{", b"["))
    with pytest.raises(RecordError, match=r"cannot read .*events\.jsonl: Expecting"):
        GrowingRun(recorder.path).read_new()
    events.write_bytes(whole)

    assert not growing.has_ended()
    recorder.close("success", "", ENDED)
    assert growing.has_ended()
    assert len(list_lines(open_run(recorder.path)).pictures) == 1


def test_a_run_is_followed_to_the_last_line_that_was_written_before_its_end(tmp_path: Path) -> None:
    """A look at which nothing was new is told too; between two of those passes the time of the clock."""
    recorder, clock = begin(tmp_path), SimulatedClock()
    followed = GrowingRun(recorder.path).follow(clock)
    assert not next(followed)
    recorder.event("run_start", 0.0, experiment="steerability")
    assert [event["kind"] for event in next(followed).events] == ["run_start"]
    assert clock.now_s() > 0.0
    recorder.event("run_stop", 1.0, exit_status="success")
    recorder.close("success", "", ENDED)
    assert [len(lines.events) for lines in followed] == [1, 0]
