"""Replaying a record through the same procedure."""

import shutil
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest

from labrig.clock import Clock
from labrig.devices.camera import Exposure, PictureSource
from labrig.devices.operator import ShiftToHole
from labrig.errors import RecordError
from labrig.experiments.declared import PROTOCOL_MODELS
from labrig.experiments.registry import find_run_experiment, load_run_protocol
from labrig.protocol.load import load_protocol
from labrig.record.agreement import Deviation, Verdict
from labrig.record.json_lines import as_recorded, decode_line, encode_line
from labrig.record.reader import Run, open_run
from labrig.runner.replay import Replay, replay_run
from tests.runner.sessions import PROTOCOLS, RunBench, Told, Watched, bench, record_run, sweep

KEPT = Path(__file__).parents[1] / "records"
ROLLS = ("roll_zero.rolls=5", "roll_zero.length_mm=12")


def replay(run: Run) -> Replay:
    """Replay a run opened afresh."""
    again = open_run(run.path)
    return replay_run(again, find_run_experiment(again), load_run_protocol(again), Told())


@pytest.fixture(scope="module")
def insertion(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """A sweep of one insertion."""
    return record_run(tmp_path_factory.mktemp("runs"), sweep())


@pytest.mark.parametrize("name", ["camera-calibration", "design", "insertion", "roll-zero", "steerability"])
def test_every_line_of_a_kept_record_comes_again(name: str) -> None:
    """Every move, picture, question, reading and event is compared, and none decides otherwise."""
    found = replay(run := open_run(KEPT / name))
    assert found.first_difference is None
    assert sum(found.counts.get(what, 0) for what in ("moves", "questions", "events")) == len(run.events)
    assert found.counts.get("pictures", 0) == len(run.frame_table)
    last = run.events["seq"].max()
    assert found.counts.get("readings", 0) == sum(line["seq"] < last for line in run.lines("states"))


def test_a_replay_is_identical_and_writes_nothing(insertion: Run) -> None:
    """The same processor gives the last bit again; neither the record nor a state file is changed."""
    before = {path: path.read_bytes() for path in insertion.path.parent.rglob("*") if path.is_file()}
    found = replay(insertion)
    assert (found.verdict, found.agreement.largest) == (Verdict.IDENTICAL, {})
    assert {path: path.read_bytes() for path in insertion.path.parent.rglob("*") if path.is_file()} == before


def replay_with(run: Run, *overrides: str) -> Replay:
    """Replay a run with another procedure."""
    return replay_run(run, find_run_experiment(run), sweep(*overrides), Told())


def test_a_target_beyond_ten_increments_is_a_difference(insertion: Run) -> None:
    """An insertion of 39 mm instead of 40 differs at the target of that move, after two pictures, and goes on."""
    found = replay_with(insertion, "insertion.length_mm=39")
    assert found.verdict is Verdict.DIFFERENT
    assert found.first_difference == Deviation("move.insertion_mm", 40.0, 39.0, 1.0, 10 / 4000)
    assert found.place is not None
    assert (found.place.frame, found.place.trial, found.stopped) == (1, 0, False)
    assert found.counts["moves"] == sum(insertion.events["kind"] == "move")
    other_needle = replay_with(insertion, "needle.needle_id=N2")
    assert other_needle.first_difference == Deviation("operator.details.needle_id", "N1", "N2")


@pytest.mark.parametrize(("off_mm", "verdict"), [(0.002, "equivalent"), (0.003, "different")])
def test_a_target_within_ten_increments_is_equivalent(insertion: Run, off_mm: float, verdict: str) -> None:
    """The screw has 4000 increments a mm: 0.0025 mm are allowed, and the difference is told."""
    found = replay_with(insertion, f"insertion.length_mm={40 - off_mm}")
    assert str(found.verdict) == verdict
    assert found.agreement.largest["move.insertion_mm"] == pytest.approx(off_mm)


@pytest.mark.parametrize(
    ("override", "recorded", "now"),
    [
        ("insertions_per_specimen=2", "run_stop", "question ShiftToHole"),
        ("insertion.frame_every_mm=20", "frame (role advance", "a reading of the axes"),
        ("insertion.frame_every_mm=3", "state", "one more picture"),
    ],
)
def test_a_procedure_that_does_more_or_less_differs(
    insertion: Run, override: str, recorded: str, now: str
) -> None:
    """An additional insertion, a missing picture and an additional picture are found where they happen."""
    found = replay_with(insertion, override)
    first = found.first_difference
    assert first is not None
    assert (found.stopped, first.quantity) == (True, "what is asked")
    assert (recorded in str(first.recorded), now in str(first.now)) == (True, True)


def edit_events(run: Run, tmp_path: Path, change: Callable[[dict[str, object]], dict[str, object]]) -> Run:
    """Return an open copy of a run with edited events and valid checksums."""
    copy = Path(shutil.copytree(run.path, tmp_path / "edited"))
    lines = [decode_line(line) for line in (copy / "events.jsonl").read_bytes().splitlines()]
    (copy / "events.jsonl").write_bytes(b"".join(encode_line(change(as_recorded(line))) for line in lines))
    return Run(copy, run.manifest, ())


def test_a_record_that_says_something_else_than_was_done_is_found(insertion: Run, tmp_path: Path) -> None:
    """An event edited together with its checksum differs from that of the procedure."""

    def change(event: dict[str, object]) -> dict[str, object]:
        return event | {"asked_position": 41.0} if event.get("asked_position") == 40.0 else event

    run = edit_events(insertion, tmp_path, change)
    difference = replay_run(run, find_run_experiment(run), load_run_protocol(run), Told()).first_difference
    assert difference is not None
    assert (difference.recorded, difference.now) == (41.0, 40.0)


def test_an_answer_that_is_missing_is_damage(insertion: Run, tmp_path: Path) -> None:
    """A line without its answer, and a line that is not there, are named; nothing is guessed."""

    def forget(event: dict[str, object]) -> dict[str, object]:
        return {key: value for key, value in event.items() if key != "confirmed"}

    run = edit_events(insertion, tmp_path / "a", forget)
    with pytest.raises(RecordError, match="lacks a value: 'confirmed'"):
        replay_run(run, find_run_experiment(run), load_run_protocol(run), Told())
    other = edit_events(insertion, tmp_path / "b", lambda event: event)
    lines = (other.path / "events.jsonl").read_bytes().splitlines(keepends=True)
    (other.path / "events.jsonl").write_bytes(b"".join((*lines[:5], *lines[6:])))
    with pytest.raises(RecordError, match=r"lacks line \d+ of its session"):
        replay_run(other, find_run_experiment(other), load_run_protocol(other), Told())


def make_run(folder: Path, then: Callable[[RunBench, str], None], *overrides: str) -> Run:
    """Record a sweep, and call `then` with each sentence of its progress."""
    with bench(folder, sweep(), overrides) as at:
        at.opened.rig.operator = Watched(at.opened.rig.operator)
        return at.conduct(sweep(), partial(then, at))[1]


def send_signal(at: RunBench, doing: str) -> None:
    """Send a signal once the needle is withdrawn."""
    if "withdrawing" in doing:
        at.opened.signal.name = "TERM"


def say_no(at: RunBench, _doing: str) -> None:
    """Let the operator decline the next hole."""
    operator = at.opened.rig.operator
    assert isinstance(operator, Watched)
    operator.declines = ShiftToHole


def do_nothing(_at: RunBench, _doing: str) -> None:
    """Leave it to the fault."""


@pytest.mark.parametrize(
    ("then", "fault", "exit_status"),
    [
        (send_signal, "", "aborted"),
        (say_no, "", "aborted"),
        (do_nothing, "fault: boot-up, axis: linear, at_s: 20", "failed"),
        (do_nothing, "fault: unplugged, at_s: 25", "failed"),
        (do_nothing, "fault: bus-off, at_s: 25", "failed"),
        (do_nothing, "fault: blocked, axis: insertion, at_s: 8, once: moving", "failed"),
    ],
)
def test_a_run_that_ended_early_comes_again(
    then: Callable[[RunBench, str], None], fault: str, exit_status: str, tmp_path: Path
) -> None:
    """A signal, an answer, a fault and a stall come where the record has them; everything before is the same."""
    faults = [f"faults=[{{{fault}}}]", "axes.insertion.max_current_ma=800"] if fault else []
    run = make_run(tmp_path, then, *faults)
    assert run.manifest["exit_status"] == exit_status
    found = replay(run)
    assert found.verdict is Verdict.IDENTICAL, found.first_difference
    assert found.counts["readings"] == sum(run.states["seq"] < run.events["seq"].max())


def test_a_killed_run_is_followed_to_its_end(tmp_path: Path) -> None:
    """The replay of a killed run states where its record ends, and that it is identical up to there."""

    def copy(at: RunBench, doing: str) -> None:
        if "withdrawing" in doing:
            shutil.copytree(at.recorder.path, tmp_path / "killed", ignore=shutil.ignore_patterns(".lock*"))

    make_run(tmp_path, copy)
    run = open_run(tmp_path / "killed")
    found = replay(run)
    assert found.verdict is Verdict.IDENTICAL, found.first_difference
    assert found.ended_early.startswith("the session that began at t = 0.000 s was interrupted at t = ")
    assert found.counts["readings"] == len(run.states)


def test_a_resumed_run_is_replayed_session_by_session(tmp_path: Path) -> None:
    """The interrupted session and the resumed one, with its withdrawal, are both replayed."""
    with bench(tmp_path / "again", sweep()) as again:
        outcome, run = again.resume(make_run(tmp_path, send_signal))
    assert outcome.exit_status == "success"
    found = replay(run)
    assert found.verdict is Verdict.IDENTICAL, found.first_difference
    assert found.counts["readings"] == len(run.states) - 2  # where the axes came to rest in each session


class _StampedSource:
    """A camera with a delay before the exposure, a transfer time and time stamps."""

    def __init__(self, source: PictureSource, clock: Clock) -> None:
        self._source, self._clock = source, clock
        self.set, self.get, self.close = source.set, source.get, source.close

    def read(self) -> Exposure | None:
        """Take 13 ms until the exposure, and 27 ms more."""
        self._clock.sleep(0.013)
        exposure, t_s = self._source.read(), self._clock.now_s()
        self._clock.sleep(0.027)
        return None if exposure is None else replace(exposure, t_s=t_s, t_bound_s=0.005)


def test_pictures_that_have_times_of_their_own_come_again(tmp_path: Path) -> None:
    """Positions are interpolated to the exposure, in the replay as in the run."""
    near = ("target.position_mm=[0, 2, 20]", "obstacles=[]", "insertion.frame_every_mm=4", *ROLLS)
    protocol = load_protocol(PROTOCOLS / "insertion.yaml", PROTOCOL_MODELS, near)
    with bench(tmp_path, protocol) as at:
        rig = at.opened.rig
        rig.camera._source = _StampedSource(rig.camera._source, rig.clock)
        _, run = at.conduct(protocol)
    seen = [line for line in run.lines("frames") if not line.get("drawn")]
    assert {round(line["fraction"], 6) for line in seen} == {0.325}
    assert {line["t_bound_s"] for line in seen} == {0.005}
    assert replay(run).verdict is Verdict.IDENTICAL
