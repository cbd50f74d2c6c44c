"""Resuming a run that left its needle in tissue."""

from pathlib import Path

import pytest

from labrig.devices.operator import (
    ConfirmNeedleOut,
    ConfirmUnchanged,
    MountNeedle,
    WithdrawNeedle,
)
from labrig.experiments.registry import find_experiment
from labrig.experiments.steerability.protocol import SteerabilityProtocol
from labrig.record.reader import Run, open_run
from labrig.record.writer import reopen_run
from labrig.runner.conduct import Outcome, conduct
from labrig.runner.past import read_past
from labrig.runner.session import Session
from tests.runner.sessions import RunBench, Told, Watched, bench, sweep


def _stop_while_inserting(at: RunBench, protocol: SteerabilityProtocol) -> Run:
    """Send a signal during an insertion, and leave the needle in tissue."""

    def then(doing: str) -> None:
        if "withdrawing" in doing:
            at.opened.signal.name = "TERM"

    outcome = conduct(
        find_experiment(protocol.experiment), protocol, Session(at.opened.rig, at.recorder, Told(then))
    )
    assert outcome.exit_status == "aborted"
    at.opened.signal.name = None
    return open_run(at.recorder.path)


def _go_on(at: RunBench, protocol: SteerabilityProtocol, run: Run) -> tuple[Outcome, Run]:
    recorder = reopen_run(run.path, "test")
    sweep_experiment = find_experiment(protocol.experiment)
    session = Session(at.opened.rig, recorder, Told())
    outcome = conduct(sweep_experiment, protocol, session, read_past(run))
    return outcome, open_run(run.path)


@pytest.fixture
def protocol() -> SteerabilityProtocol:
    """One insertion into one gel."""
    loaded = sweep()
    assert isinstance(loaded, SteerabilityProtocol)
    return loaded


def test_the_needle_is_withdrawn_along_its_path_before_anything_is_referenced(
    tmp_path: Path, protocol: SteerabilityProtocol
) -> None:
    """If the drives kept their references, a withdrawal is offered, and only one question besides the next hole."""
    with bench(tmp_path, protocol) as at:
        run = _stop_while_inserting(at, protocol)
        assert at.opened.rig.state.needle_in_tissue
        outcome, run = _go_on(at, protocol, run)
    assert outcome.exit_status == "success"
    after = run.events[run.events["t_s"] > run.trials["start_t_s"][0]].to_dict("records")
    kinds = [event["request"] if event["kind"] == "operator" else event["kind"] for event in after]
    start = kinds.index("run_resume")
    assert kinds[start + 1 : start + 4] == ["trial_stop", "WithdrawNeedle", "withdrawal_start"]
    asked = kinds[kinds.index("withdrawal_stop") + 1 :]
    assert asked[:2] == ["ConfirmUnchanged", "ShiftToHole"]
    assert "ConfirmAxesAtZero" not in asked
    assert list(run.trials["exit_status"]) == ["interrupted", "success"]


def test_what_may_have_changed_is_asked_for_again(tmp_path: Path, protocol: SteerabilityProtocol) -> None:
    """If the operator does not confirm that all is as it was, needle, zero and specimen are asked for."""
    with bench(tmp_path, protocol) as at:
        run = _stop_while_inserting(at, protocol)
        at.opened.rig.operator = watched = Watched(at.opened.rig.operator, declines=ConfirmUnchanged)
        outcome, _ = _go_on(at, protocol, run)
    assert outcome.exit_status == "success"
    assert [type(request).__name__ for request in watched.asked] == [
        "WithdrawNeedle", "ConfirmUnchanged", "MountNeedle", "ConfirmAxesAtZero", "PlaceSpecimen", "ShiftToHole",
    ]  # fmt: skip


@pytest.mark.parametrize("is_referenced", [True, False])
def test_a_needle_that_is_not_withdrawn_is_asked_about(
    is_referenced: bool, tmp_path: Path, protocol: SteerabilityProtocol
) -> None:
    """The operator declines, or a drive has lost its reference: nothing moves until the needle is confirmed out."""
    with bench(tmp_path, protocol) as at:
        run = _stop_while_inserting(at, protocol)
        depth_mm = at.opened.rig.read_states()["insertion"].position
        if not is_referenced:
            at.opened.rig.needle.forget_references(["linear"])
        at.opened.rig.operator = watched = Watched(
            at.opened.rig.operator, declines=(WithdrawNeedle, ConfirmNeedleOut)
        )
        outcome, run = _go_on(at, protocol, run)
        asked = [WithdrawNeedle, ConfirmNeedleOut] if is_referenced else [ConfirmNeedleOut]
        assert [type(request) for request in watched.asked] == asked
        assert at.opened.rig.read_states()["insertion"].position == depth_mm
        assert at.opened.rig.state.needle_in_tissue
    assert outcome.exit_status == "aborted"


def test_a_run_that_was_stopped_before_its_first_insertion_goes_on_from_the_start(
    tmp_path: Path, protocol: SteerabilityProtocol
) -> None:
    """A run without any insertion is resumed with all of them, and no trial is marked as interrupted."""
    with bench(tmp_path, protocol) as at:
        at.opened.rig.operator = Watched(at.opened.rig.operator, declines=MountNeedle)
        assert conduct(find_experiment(protocol.experiment), protocol, at.session).exit_status == "aborted"
        at.opened.rig.operator = at.opened.hardware.operator
        outcome, run = _go_on(at, protocol, open_run(at.recorder.path))
    assert outcome.exit_status == "success"
    assert list(run.trials["exit_status"]) == ["success"]
