"""Replaying a record through the same procedure."""

import random
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from labrig.clock import Clock
from labrig.devices.camera import Exposure, PictureSource
from labrig.devices.clocks import SimulatedClock
from labrig.devices.operator import ShiftToHole
from labrig.devices.replayed.comparison import ReplayDifference
from labrig.devices.replayed.opening import load_recorded_rig
from labrig.devices.replayed.recording import read_recordings
from labrig.devices.rig import Guards
from labrig.errors import InputError
from labrig.experiments.declared import PROTOCOL_MODELS
from labrig.experiments.hinge_design.protocol import DesignProtocol
from labrig.experiments.registry import find_experiment, find_run_experiment, load_run_protocol
from labrig.experiments.steerability.protocol import SteerabilityProtocol
from labrig.protocol.load import load_protocol
from labrig.protocol.sections import ExperimentProtocol
from labrig.protocol.yaml_file import dump_yaml
from labrig.record.json_lines import as_recorded, decode_line, encode_line
from labrig.record.reader import Run, open_run
from labrig.record.writer import Recorder
from labrig.runner.conduct import conduct, conduct_remainder, conduct_without_rig
from labrig.runner.replay import Replay, _replay_session, _Replayed, replay_run
from labrig.runner.session import Session
from tests.record.faults import killed_run
from tests.runner.sessions import EXAMPLES, PROTOCOLS, RunBench, Told, Watched, bench, sweep


def replay(run: Run) -> Replay:
    """Replay a run opened afresh."""
    again = open_run(run.path)
    return replay_run(again, find_run_experiment(again), load_run_protocol(again), Told())


def record_run(tmp_path: Path, protocol: ExperimentProtocol, *overrides: str) -> Run:
    """Record a run on the simulated rig."""
    with bench(tmp_path, protocol, overrides) as at:
        _, run = at.conduct(protocol)
    return run


@pytest.fixture(scope="module")
def insertion(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """A sweep of one insertion."""
    return record_run(tmp_path_factory.mktemp("runs"), sweep())


SHORTER = {
    "steerability": ("insertions_per_specimen=1", "specimens=[{name: gel-10, gelatin_percent: 10}]"),
    "calibration": ("views=4",),
    "roll-zero": (
        "roll_zero.length_mm=12",
        "roll_zero.torsion.depths_mm=[20, 26, 32]",
        "roll_zero.torsion.further_mm=10",
        "roll_zero.torsion.max_sd_deg=20",
    ),
    "insertion": (
        "target.position_mm=[0, 3, 40]",
        "obstacles=[]",
        "insertion.frame_every_mm=4",
        "roll_zero.rolls=4",
        "roll_zero.length_mm=12",
    ),
}
"""What makes long example protocols short enough for a test."""


@pytest.mark.parametrize("name", EXAMPLES)
def test_every_example_protocol_comes_again_to_the_last_bit(tmp_path: Path, name: str) -> None:
    """A replay gives every command, question, event, state, picture and CAN frame, times included."""
    protocol = load_protocol(PROTOCOLS / f"{name}.yaml", PROTOCOL_MODELS, SHORTER.get(name, ()))
    run = (
        record_design(tmp_path, protocol)
        if isinstance(protocol, DesignProtocol)
        else record_run(tmp_path, protocol)
    )
    found = replay(run)
    assert (found.first_difference, found.bit_exact) == (None, True)
    assert found.counts["events"] == len(run.events)
    assert found.counts.get("frames", 0) == len(run.frame_table)
    assert found.counts.get("questions", 0) == sum(run.events["kind"] == "operator")


@pytest.mark.parametrize("sparing", [True, False])
def test_a_record_that_read_targets_more_often_replays_identically(tmp_path: Path, sparing: bool) -> None:
    """Records name the same guards whether they read targets as often as the first of them or as rarely as now."""
    guards = Guards.recorded(3, exact=True, sparing=sparing)
    protocol = sweep("insertion.length_mm=22", "insertion.speed_mm_s=5")
    with bench(tmp_path, protocol, (), guards) as at:
        _, run = at.conduct(protocol)
    assert read_recordings(run, exact=True)[0].guards == 3
    found = replay(run)
    assert (found.first_difference, found.bit_exact) == (None, True)


def record_design(tmp_path: Path, protocol: DesignProtocol) -> Run:
    """Record a run that moves nothing."""
    clock = SimulatedClock()
    manifest = {"experiment": "design", "started": clock.utc()}
    recorder = Recorder.create(tmp_path, "run", manifest, dump_yaml(protocol), None, {})
    conduct_without_rig(find_experiment("design"), recorder, clock)
    return open_run(recorder.path)


def test_nothing_is_written_by_a_replay(insertion: Run) -> None:
    """A replay changes neither the record nor a state file."""
    before = {path: path.read_bytes() for path in insertion.path.parent.rglob("*") if path.is_file()}
    replay(insertion)
    assert {path: path.read_bytes() for path in insertion.path.parent.rglob("*") if path.is_file()} == before


def replay_with(run: Run, *overrides: str) -> ReplayDifference | None:
    """Replay a run with another procedure, and return the first difference."""
    return replay_run(run, find_run_experiment(run), sweep(*overrides), Told()).first_difference


def test_the_first_command_that_differs_is_named_with_both_values(insertion: Run) -> None:
    """An insertion of 39 mm instead of 40 differs at the target of that move, after two pictures."""
    difference = replay_with(insertion, "insertion.length_mm=39")
    assert difference is not None
    assert (difference.what, difference.frame, difference.trial) == ("command", 1, 0)
    assert difference.recorded.startswith("insertion: target position (0x607A:00) = ")
    assert difference.recorded.endswith("quadcounts, 40.0000 mm")
    assert difference.now.endswith("quadcounts, 39.0000 mm")
    moves = insertion.events[insertion.events["kind"] == "move"]
    assert 0 <= float(moves["t_s"].iloc[2]) - difference.t_s < 0.1


def test_a_question_that_differs_is_named(insertion: Run) -> None:
    """Another needle differs at the first question, before anything moves."""
    difference = replay_with(insertion, "needle.needle_id=N2")
    assert difference is not None
    assert (difference.what, difference.frame) == ("question", None)
    assert "N1" in difference.recorded
    assert "N2" in difference.now


@pytest.mark.parametrize(
    ("override", "what", "recorded", "now"),
    [
        ("insertions_per_specimen=2", "question", "nothing", "ShiftToHole"),
        ("insertion.frame_every_mm=20", "state", "insertion_mm = 5.", "insertion_mm = 5."),
        ("insertion.frame_every_mm=3", "frame", "frame: t_s = 9.", "frame: t_s = 8."),
    ],
)
def test_a_procedure_that_does_more_or_less_differs(
    insertion: Run, override: str, what: str, recorded: str, now: str
) -> None:
    """An additional insertion, a missing picture and an additional picture are found where they happen."""
    difference = replay_with(insertion, override)
    assert difference is not None
    assert (difference.what, recorded in difference.recorded, now in difference.now) == (what, True, True)


def edit_events(run: Run, tmp_path: Path, change: Callable[[dict[str, object]], dict[str, object]]) -> Run:
    """Return an open copy of a run with edited events and valid checksums."""
    copy = tmp_path / "edited"
    copy.mkdir()
    for path in run.path.rglob("*"):
        if path.is_file():
            (copy / path.relative_to(run.path)).parent.mkdir(parents=True, exist_ok=True)
            (copy / path.relative_to(run.path)).write_bytes(path.read_bytes())
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
    assert (difference.recorded, difference.now) == (
        "move: asked_position = 41.0",
        "move: asked_position = 40.0",
    )


def _signal_while_withdrawing(at: RunBench) -> Session:
    def then(doing: str) -> None:
        if "withdrawing" in doing:
            at.opened.signal.name = "TERM"

    return Session(at.opened.rig, at.recorder, Told(then))


def test_a_run_that_a_signal_stopped_comes_again_with_its_stop(tmp_path: Path) -> None:
    """The signal arrives at the recorded place, and the same commands stop the axes."""
    protocol = sweep()
    with bench(tmp_path, protocol) as at:
        assert (
            conduct(find_experiment(protocol.experiment), protocol, _signal_while_withdrawing(at)).exit_status
            == "aborted"
        )
    run = open_run(at.recorder.path)
    found = replay(run)
    assert (found.identical, found.bit_exact) == (True, True)
    assert found.counts["events"] == len(run.events)


@pytest.mark.parametrize(
    "fault",
    [
        "{fault: boot-up, axis: linear, at_s: 20}",
        "{fault: late-frames, at_s: 30, count: 3}",
        "{fault: unplugged, at_s: 25}",
        "{fault: bus-off, at_s: 25}",
    ],
)
def test_faults_of_devices_come_again(tmp_path: Path, fault: str) -> None:
    """Records with a drive restart, lost frames or a lost adapter are replayed as far as they go."""
    run = record_run(tmp_path, sweep(), f"faults=[{fault}]")
    found = replay(run)
    assert found.identical, found.first_difference
    assert found.counts["states"] == len(run.states)


def test_an_operator_who_said_no_says_it_again(tmp_path: Path) -> None:
    """The recorded answers are given again, and the run is aborted at the same question."""
    protocol = sweep()
    with bench(tmp_path, protocol) as at:
        at.opened.rig.operator = Watched(at.opened.rig.operator, declines=ShiftToHole)
        _, run = at.conduct(protocol)
    assert run.manifest["exit_status"] == "aborted"
    found = replay(run)
    assert (found.identical, found.bit_exact) == (True, True)
    assert found.counts["events"] == len(run.events)


def test_a_killed_run_is_followed_to_its_end(tmp_path: Path) -> None:
    """The replay of a killed run states where its record ends, and that it is identical up to there."""
    protocol = sweep()
    with bench(tmp_path, protocol) as at:
        copy = tmp_path / "killed"

        def then(doing: str) -> None:
            if "withdrawing" in doing:
                for path in at.recorder.path.rglob("*"):
                    if path.is_file() and path.name != ".lock":
                        (copy / path.relative_to(at.recorder.path)).parent.mkdir(parents=True, exist_ok=True)
                        (copy / path.relative_to(at.recorder.path)).write_bytes(path.read_bytes())

        conduct(
            find_experiment(protocol.experiment), protocol, Session(at.opened.rig, at.recorder, Told(then))
        )
    run = open_run(copy)
    found = replay(run)
    assert found.identical, found.first_difference
    assert found.ended_early.startswith("the session that began at t = 0.000 s was interrupted at t = ")
    assert found.counts["states"] == len(run.states)


def test_a_resumed_run_is_replayed_session_by_session(tmp_path: Path) -> None:
    """The interrupted session and the resumed one, with its withdrawal, are both replayed."""
    protocol = sweep()
    assert isinstance(protocol, SteerabilityProtocol)
    with bench(tmp_path, protocol) as at:
        conduct(find_experiment(protocol.experiment), protocol, _signal_while_withdrawing(at))
    run = open_run(at.recorder.path)
    with bench(tmp_path / "again", protocol) as again:
        recorder = Recorder.reopen(run.path, "test")
        devices = open_run(again.recorder.path).manifest["devices"]
        recorder.begin_session(again.opened.rig.clock.utc(), devices=devices)
        experiment = find_run_experiment(run)
        remainder = experiment.resume(protocol, run)
        outcome = conduct_remainder(experiment, remainder, Session(again.opened.rig, recorder, Told()))
    assert outcome.exit_status == "success"
    found = replay(run)
    assert (found.identical, found.bit_exact) == (True, True), found.first_difference
    assert found.counts["events"] == len(open_run(run.path).events)


def test_imported_pictures_cannot_be_replayed(tmp_path: Path) -> None:
    """A run that was not made by a procedure is refused by name."""
    with pytest.raises(InputError, match="no procedure made it"):
        replay(open_run(killed_run(tmp_path)))


class _StampedSource:
    """A camera with a delay before the exposure, a transfer time and time stamps."""

    def __init__(self, source: PictureSource, clock: Clock) -> None:
        self.exposures = 0
        self._source, self._clock = source, clock
        self.set, self.get, self.close = source.set, source.get, source.close

    def read(self) -> Exposure | None:
        """Take 13 ms until the exposure, and 27 ms more."""
        self.exposures += 1
        self._clock.sleep(0.013)
        exposure, t_s = self._source.read(), self._clock.now_s()
        self._clock.sleep(0.027)
        return None if exposure is None else replace(exposure, t_s=t_s, t_bound_s=0.005)


def test_pictures_that_have_times_of_their_own_come_again(tmp_path: Path) -> None:
    """Positions are interpolated to the exposure, in the replay as in the run."""
    protocol = load_protocol(PROTOCOLS / "insertion.yaml", PROTOCOL_MODELS, SHORTER["insertion"])
    with bench(tmp_path, protocol) as at:
        rig = at.opened.rig
        rig.camera._source = _StampedSource(rig.camera._source, rig.clock)
        _, run = at.conduct(protocol)
    seen = [line for line in run.lines("frames") if not line.get("drawn")]
    assert {round(line["fraction"], 6) for line in seen} == {0.325}
    assert {line["t_bound_s"] for line in seen} == {0.005}
    assert replay(run).first_difference is None
    late = Replay()
    (exact,) = read_recordings(open_run(run.path), exact=False)
    frames = tuple(frame._replace(t_s=1.01 * frame.t_s) for frame in exact.can_frames)
    replayed = _Replayed(run, find_run_experiment(run), load_run_protocol(run), load_recorded_rig(run))
    _replay_session(replayed, replace(exact, can_frames=frames), Told(), late)
    assert late.first_difference is None


@pytest.mark.parametrize("slower", [1.0, 1.01])
def test_a_record_of_real_time_is_identical_though_its_times_are_not_ours(
    insertion: Run, slower: float
) -> None:
    """The replay of a run in real time is identical, although every wait takes a different time."""
    source = random.Random(3)
    (exact,) = read_recordings(insertion, exact=False)
    late_s, frames = 0.0, []
    for frame in exact.can_frames:
        late_s += source.uniform(0.0, 0.0005) if frame.way == "T" else 0.0
        frames.append(frame._replace(t_s=slower * frame.t_s + late_s))
    found = Replay()
    recording = replace(exact, can_frames=tuple(frames))
    replayed = _Replayed(
        insertion, find_run_experiment(insertion), load_run_protocol(insertion), load_recorded_rig(insertion)
    )
    _replay_session(replayed, recording, Told(), found)
    assert found.first_difference is None
    assert found.counts["states"] == len(insertion.states)
    assert not found.bit_exact
