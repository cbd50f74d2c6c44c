"""An interrupted run of insertions goes on: what is kept, what is made again, and its replay."""

from pathlib import Path

from labrig.devices.operator import MountNeedle
from labrig.experiments.declared import PROTOCOL_MODELS, find_experiment
from labrig.experiments.insertion.events import InsertionStart, InsertionStop, MarkersSought
from labrig.experiments.registry import load_run_protocol
from labrig.protocol.load import load_protocol
from labrig.record.reader import Run, open_run
from labrig.runner.dry_run import plan_run
from labrig.runner.experiment import RunPlan
from labrig.runner.past import read_past
from tests.devices.rigs import large_rig
from tests.experiments.insertion.test_markers import BOUND, MOVES, world
from tests.experiments.insertion.test_procedure import EVEN, FROM_THE_BEGINNING
from tests.runner.sessions import PROTOCOLS, Watched, large_bench
from tests.runner.test_pausing import require_identical


def test_a_run_of_insertions_goes_on_where_it_was_broken(tmp_path: Path) -> None:
    """The first insertion is kept, the second was stopped and is made again with its markers; both sessions replay."""
    twice = (*FROM_THE_BEGINNING, *BOUND, "repetitions=2")
    protocol = load_protocol(PROTOCOLS / "insertion.yaml", PROTOCOL_MODELS, twice)
    laid = (*EVEN, world(), MOVES)
    with large_bench(tmp_path, protocol, laid) as at:

        def then(doing: str) -> None:
            if doing.startswith("inserted 1") and open_run(at.recorder.path).trials.shape[0] == 2:
                at.opened.signal.name = "TERM"

        outcome, run = at.conduct(protocol, then)
    assert outcome.exit_status == "aborted"
    assert plan_left(run).trials == 1
    with large_bench(tmp_path / "again", protocol, laid) as again:
        watched = again.opened.rig.operator = Watched(again.opened.rig.operator)
        outcome, run = again.resume(run)
    assert outcome.exit_status == "success"
    assert sum(isinstance(request, MountNeedle) for request in watched.asked) == 1
    trials = run.read_trials(InsertionStart, InsertionStop)
    assert [(trial.start.trial, trial.start.repeats, trial.exit_status) for trial in trials] == [
        (0, None, "success"), (1, None, "interrupted"), (2, 1, "success"),
    ]  # fmt: skip
    starts = {event.trial: event.depth_mm for event in reversed(run.read_events(MarkersSought))}
    assert starts == {0: 0.0, 1: 0.0, 2: 0.0}
    require_identical(run)
    assert plan_left(run).trials == 0


def plan_left(run: Run) -> RunPlan:
    """Return the plan of what is left of a run."""
    experiment, past = find_experiment("insertion"), read_past(run)
    return plan_run(experiment, load_run_protocol(run), large_rig(*EVEN, world(), MOVES), past)
