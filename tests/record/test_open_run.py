"""Reading runs; events are models that writer and readers share."""

import math
import pickle
from pathlib import Path
from typing import ClassVar

import numpy as np
import pandas as pd
import pytest

from labrig.errors import Fault, RecordError
from labrig.record.difference import list_differences
from labrig.record.events import Event, RunStop, TrialStart, TrialStop
from labrig.record.json_lines import encode_line, read_lines
from labrig.record.reader import open_run
from labrig.record.results import finish_result, new_result_dir
from labrig.record.writer import Recorder, reopen_run
from tests.record.runs import ENDED, add_result, begin, closed_run, flip_bit, interrupted_run, picture


def test_a_closed_run_gives_back_what_was_recorded(tmp_path: Path) -> None:
    """Tables, pictures, protocol, calibration and bus come back, and nothing is damaged."""
    run = open_run(closed_run(tmp_path))
    assert run.damage == ()
    assert run.protocol["experiment"] == "import"
    assert list(run.states["insertion_mm"][:3]) == [0.0, 1 / 3, 2 / 3]
    assert list(pd.read_json(run.path / "states.jsonl", lines=True)["t_s"]) == list(run.states["t_s"])
    assert list(run.trials["start_t_s"]) == [0.0, 10.0]
    assert list(run.until(10.0).states["t_s"]) == [0.0, 1.0, 2.0]  # the trial that begins then is not in it
    assert list(run.events["kind"]) == ["run_start", *(["trial_start", "trial_stop"] * 2), "run_stop"]
    assert list(run.truth["radius_mm"]) == [27.5, 28.5]
    assert list(run.frame_table["role"]) == ["advance", "final"] * 2
    first = run.frame_lines[0]
    assert (first.frame, first.trial, first.role, first.insertion_mm, first.linear_mm) == (
        0,
        0,
        "advance",
        1.0,
        None,
    )
    for number, image in enumerate(run.pictures):
        np.testing.assert_array_equal(image, picture(number))
    assert run.calibration_path("intrinsics.json").read_bytes() == b'{"fx": 1.0}'


def test_an_empty_run_has_the_columns(tmp_path: Path) -> None:
    """Tables of a run that recorded nothing are empty and have the columns that code asks for."""
    run = open_run(begin(tmp_path).path)
    assert list(run.states.columns) == ["t_s"]
    assert list(run.events.columns) == ["kind", "t_s"]
    assert list(run.trials.columns) == ["trial", "start_t_s", "stop_t_s", "exit_status", "final_frame"]
    tables = (run.states, run.frame_table, run.truth, run.steps, run.measurements)
    assert (sum(map(len, tables)), len(run.pictures)) == (0, 0)
    assert run.result is None


def test_pictures_are_a_sequence_that_travels(tmp_path: Path) -> None:
    """They are counted, indexed from either end, sliced without being read, and given to another process."""
    run = open_run(closed_run(tmp_path))
    assert len(run.pictures) == 4
    np.testing.assert_array_equal(run.pictures[-1], picture(3))
    np.testing.assert_array_equal(run.pictures[1::2][1], picture(3))
    with pytest.raises(IndexError):
        run.pictures[4]
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(run)).read_frame(2), picture(2))
    with pytest.raises(RecordError, match="no frame 4; it holds 4"):
        run.read_frame(4)


@pytest.mark.parametrize(
    ("text", "match"),
    [
        (b"{", "is damaged"),
        (b"[]", "no JSON object"),
        (b"\xff", "is damaged"),
        (b'{"exit_status": "success"}', "schema version None"),
        (b'{"exit_status": "success", "schema_version": 2}', "schema version 2; this labrig reads 1"),
    ],
)
def test_a_manifest_that_cannot_be_used_is_refused(tmp_path: Path, text: bytes, match: str) -> None:
    """A broken manifest, and one of another schema, are refused with their path."""
    run = closed_run(tmp_path)
    (run / "manifest.json").write_bytes(text)
    with pytest.raises(RecordError, match=match) as refusal:
        open_run(run)
    assert str(run) in refusal.value.message


@pytest.mark.parametrize(
    "fields", [{"file": "../secret.png"}, {"frame": 0}, {"file": "frames/000001.exe"}, {"t_s": None}]
)
def test_a_line_of_a_picture_is_its_own(tmp_path: Path, fields: dict[str, object]) -> None:
    """A path out of the run, a number twice, another kind of file and no time are refused with file and line."""
    path = interrupted_run(tmp_path) / "frames.jsonl"
    lines = read_lines(path)
    lines[1] |= fields
    path.write_bytes(b"".join(map(encode_line, lines)))
    with pytest.raises(RecordError, match=r"frames\.jsonl:2"):
        _ = open_run(path.parent).pictures


def test_a_line_that_is_no_json_is_named(tmp_path: Path) -> None:
    """With file and line; so is a number that is none."""
    run = interrupted_run(tmp_path)
    (run / "events.jsonl").write_bytes(b'{"kind": "a", "t_s": 0}\n{"kind\n')
    with pytest.raises(RecordError, match=r"events\.jsonl:2: the line is damaged"):
        _ = open_run(run).events
    (run / "events.jsonl").write_bytes(b'{"kind": "trial_start", "t_s": 0, "trial": "one"}\n')
    with pytest.raises(RecordError, match="no whole number"):
        _ = open_run(run).trials


def test_results_are_numbered_and_never_overwritten(tmp_path: Path) -> None:
    """Each analysis gets a folder of its own, even after gaps; the newest finished one is the result."""
    path = closed_run(tmp_path)
    add_result(path, b'{"value": 1}')
    run = open_run(path)
    assert new_result_dir(path).name == "002"  # never finished
    (path / "analysis" / "006").mkdir()
    assert add_result(path, b'{"value": 7}').name == "007"
    assert run.result_numbers == (1, 7)
    assert run.result == {"value": 7}
    (path / "analysis" / "007" / "result.json").write_bytes(b'{"value": 8}')
    with pytest.raises(RecordError, match=r"analysis/007/result\.json"):
        _ = run.result


def test_the_tables_of_the_newest_result_are_there(tmp_path: Path) -> None:
    """A row a measurement, and a row a step, in the order of trials."""
    path = closed_run(tmp_path)
    folder = new_result_dir(path)
    (folder / "insertions.csv").write_text("trial,target_error_mm,cause\n0,0.5,'=1+1\n1,,NA\n")
    for trial in (10, 2):
        (folder / f"steps-{trial}.csv").write_text("depth_mm\n1.5\n")
    finish_result(folder)
    run = open_run(path)
    assert list(run.measurements["cause"]) == ["=1+1", "NA"]
    assert list(run.measurements["target_error_mm"].isna()) == [False, True]
    assert run.steps.to_dict("list") == {"depth_mm": [1.5, 1.5], "trial": [2, 10]}


def test_a_run_that_goes_on_keeps_its_time(tmp_path: Path) -> None:
    """Rig time goes on from the next whole second; devices of each session are kept."""
    recorder = begin(tmp_path, devices={"rig": "a", "kind": "real"})
    assert open_run(recorder.path).manifest["rig"] == {"name": "a", "kind": "real"}
    recorder.state(3.2)
    recorder.close("aborted", "SIGINT", ENDED)
    again = reopen_run(recorder.path, "labrig resume")
    assert again.begin_session(ENDED, devices={"rig": "b"}, provenance={}) == 4.0
    again.state(0.5)
    again.close("success", "", ENDED, devices_after={"rig": "c"})
    run = open_run(recorder.path)
    assert list(run.states["t_s"]) == [3.2, 4.5]
    assert run.devices == {"rig": "a", "kind": "real"}
    assert read_lines(run.path / "devices.jsonl")[-1]["devices"] == {"rig": "c"}
    with pytest.raises(RecordError, match="has come to its end"):
        reopen_run(recorder.path, "labrig resume")


def test_a_damaged_run_does_not_go_on(tmp_path: Path) -> None:
    """Nothing of it is changed, and its lock is free."""
    recorder = begin(tmp_path)
    recorder.frame(picture(0), 0.0)
    recorder.close("aborted", "", ENDED)
    flip_bit(recorder.path / "frames" / "000000.png")
    for _ in range(2):
        with pytest.raises(RecordError, match=r"is damaged: frames/000000\.png"):
            reopen_run(recorder.path, "labrig resume")


def test_a_run_shows_itself_in_a_notebook(tmp_path: Path) -> None:
    """What it is and what is wrong with it; text of the record is escaped."""
    path = closed_run(tmp_path, title="<b>&")
    flip_bit(path / "states.jsonl")
    assert all(words in open_run(path)._repr_html_() for words in ("&lt;b&gt;&amp;", "states.jsonl"))


def test_two_runs_are_compared_value_by_value(tmp_path: Path) -> None:
    """What differs, by section and dotted path; equal runs differ in nothing."""
    first = open_run(closed_run(tmp_path, "a"))
    second = open_run(closed_run(tmp_path, "b", seed=8))
    assert list_differences(first, first) == ()
    (difference,) = list_differences(first, second)
    assert (difference.section, difference.key, difference.a, difference.b) == ("run", "seed", 7, 8)


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
