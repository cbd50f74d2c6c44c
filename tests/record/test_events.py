"""Events are models that writer and readers share."""

import math
from pathlib import Path
from typing import ClassVar

import pytest

from labrig.errors import Fault, RecordError
from labrig.record.events import Event, RunStop, TrialStart, TrialStop
from labrig.record.reader import open_run
from labrig.record.writer import Recorder
from tests.record.runs import begin


class GelStart(TrialStart):
    """A trial in a gel."""

    specimen: str
    hole: int
    repeats: int | None = None


class GelStop(TrialStop):
    """The end of it."""

    final_frame: int | None = None
    sd_mm: float | None


class Flip(Event):
    """A turn."""

    kind: ClassVar[str] = "flip"

    trial: int
    to_rad: float | None


def record(recorder: Recorder, *events: Event) -> Path:
    """Record events a second apart."""
    for t_s, event in enumerate(events):
        recorder.record_event(event, float(t_s))
    return recorder.path


def test_a_line_has_the_fields_of_its_model_in_their_order(tmp_path: Path) -> None:
    """Kind, time, then the fields; one without a default is always written, None as null, a default is left out."""
    start = GelStart(trial=0, specimen="gel 10", hole=2)
    stop = GelStop(trial=0, exit_status="failed", sd_mm=None)
    fault = Fault("bus-lost", 0x8100, 0x10, "no communication")
    run = record(begin(tmp_path), start, stop, RunStop(exit_status="failed", reason="lost", fault=fault))
    started, stopped, _ = (run / "events.jsonl").read_text().splitlines()
    assert started == '{"kind":"trial_start","t_s":0.0,"trial":0,"specimen":"gel 10","hole":2,"seq":0}'
    assert stopped == '{"kind":"trial_stop","t_s":1.0,"trial":0,"exit_status":"failed","sd_mm":null,"seq":1}'
    assert open_run(run).lines("events")[-1]["fault"]["name"] == "bus-lost"


def test_events_are_read_as_they_were_recorded(tmp_path: Path) -> None:
    """With their time, in the order of the record; a line that its model does not fit is named with its field."""
    flip = Flip(trial=0, to_rad=math.pi)
    run = open_run(record(begin(tmp_path), GelStart(trial=0, specimen="gel 10", hole=2), flip))
    assert run.read_events(Flip) == (flip.model_copy(update={"t_s": 1.0}),)
    assert [type(event) for event in run.read_events(Flip, GelStart)] == [GelStart, Flip]
    assert run.read_events(TrialStart) == (TrialStart(trial=0, t_s=0.0),)
    endless = open_run(record(begin(tmp_path, "endless"), Flip(trial=0, to_rad=math.inf)))
    assert endless.read_events(Flip)[0].to_rad is None
    plain = open_run(record(begin(tmp_path, "plain"), TrialStart(trial=0)))
    with pytest.raises(RecordError, match=r"events\.jsonl:1: trial_start: 'specimen': field required"):
        plain.read_events(GelStart)


def test_trials_join_their_start_and_stop(tmp_path: Path) -> None:
    """Of a trial that was begun again, the last beginning counts."""
    first, again, other = (GelStart(trial=hole // 2, specimen="gel 10", hole=hole) for hole in range(3))
    left = GelStop(trial=0, exit_status="interrupted", sd_mm=None)
    done = GelStop(trial=0, exit_status="success", sd_mm=0.5)
    trials = open_run(record(begin(tmp_path), first, left, again, done, other)).read_trials(GelStart, GelStop)
    assert [(trial.start.hole, trial.exit_status) for trial in trials] == [(1, "success"), (2, "incomplete")]
    assert [trial.stop and trial.stop.sd_mm for trial in trials] == [0.5, None]
