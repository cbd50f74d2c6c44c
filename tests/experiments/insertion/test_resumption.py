"""An interrupted run of insertions goes on: what is kept, what is made again, and its replay."""

from pathlib import Path

from labrig.devices.operator import MountNeedle
from labrig.experiments.declared import PROTOCOL_MODELS
from labrig.experiments.insertion.events import InsertionStart, InsertionStop, MarkersSought
from labrig.experiments.registry import find_experiment
from labrig.protocol.load import load_protocol
from labrig.record.agreement import Verdict
from labrig.record.check import check_run
from labrig.record.reader import open_run
from labrig.record.writer import reopen_run
from labrig.runner.conduct import conduct
from labrig.runner.dry_run import plan_run
from labrig.runner.past import read_past
from labrig.runner.replay import replay_run
from labrig.runner.session import Session
from tests.experiments.insertion.test_markers import BOUND, MOVES, world
from tests.experiments.insertion.test_procedure import EVEN, FROM_THE_BEGINNING
from tests.runner.sessions import PROTOCOLS, Told, Watched, large_bench


def test_a_run_of_insertions_goes_on_where_it_was_broken(tmp_path: Path) -> None:
    """The first insertion is kept, the second was stopped and is made again with its markers; both sessions replay."""
    experiment = find_experiment("insertion")
    protocol = load_protocol(
        PROTOCOLS / "insertion.yaml", PROTOCOL_MODELS, (*FROM_THE_BEGINNING, *BOUND, "repetitions=2")
    )
    laid = (*EVEN, world(), MOVES)
    with large_bench(tmp_path, protocol, laid) as at:

        def then(doing: str) -> None:
            if doing.startswith("inserted 1") and open_run(at.recorder.path).trials.shape[0] == 2:
                at.opened.signal.name = "TERM"

        outcome = conduct(experiment, protocol, Session(at.opened.rig, at.recorder, Told(then)))
    assert outcome.exit_status == "aborted"
    run = open_run(at.recorder.path)
    with large_bench(tmp_path / "again", protocol, laid) as again:
        recorder = reopen_run(run.path, "test")
        devices = open_run(again.recorder.path).devices
        recorder.begin_session(again.opened.rig.clock.utc(), devices=devices)
        watched = again.opened.rig.operator = Watched(again.opened.rig.operator)
        past = read_past(run)
        assert (past.kept, plan_run(experiment, protocol, again.opened.rig.description, past).trials) == (
            1,
            1,
        )
        session = Session(again.opened.rig, recorder, Told())
        outcome = conduct(experiment, protocol, session, past)
    assert outcome.exit_status == "success"
    assert sum(isinstance(request, MountNeedle) for request in watched.asked) == 1
    run = open_run(run.path)
    trials = run.read_trials(InsertionStart, InsertionStop)
    assert [(trial.start.trial, trial.start.repeats, trial.exit_status) for trial in trials] == [
        (0, None, "success"),
        (1, None, "interrupted"),
        (2, 1, "success"),
    ]
    starts = {event.trial: event.depth_mm for event in reversed(run.read_events(MarkersSought))}
    assert starts == {0: 0.0, 1: 0.0, 2: 0.0}
    assert check_run(run.path).damage == ()
    found = replay_run(run, experiment, protocol, Told())
    assert found.verdict is Verdict.IDENTICAL, found.first_difference
    assert plan_run(experiment, protocol, again.opened.rig.description, read_past(run)).trials == 0
