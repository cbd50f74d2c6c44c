"""Resuming a run that left its needle in tissue."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from labrig.devices.operator import ConfirmNeedleOut, ConfirmUnchanged, MountNeedle, WithdrawNeedle
from labrig.record.reader import Run, open_run
from labrig.runner.conduct import Outcome
from tests.runner.sessions import RunBench, Watched, bench, sweep

Declined = type[object] | tuple[type[object], ...]
UNCHANGED = ["WithdrawNeedle", "ConfirmUnchanged", "ShiftToHole"]
CHANGED = [*UNCHANGED[:2], "MountNeedle", "ConfirmAxesAtZero", "PlaceSpecimen", "ShiftToHole"]


@pytest.fixture
def stopped(tmp_path: Path) -> Iterator[RunBench]:
    """The bench of a sweep of one insertion, which a signal has ended with the needle in tissue."""
    with bench(tmp_path, sweep()) as at:

        def then(doing: str) -> None:
            if "withdrawing" in doing:
                at.opened.signal.name = "TERM"

        assert at.conduct(sweep(), then)[0].exit_status == "aborted"
        assert at.opened.rig.state.needle_in_tissue
        at.opened.signal.name = None
        yield at


def go_on(at: RunBench, declines: Declined = ()) -> tuple[Outcome, Run, list[str]]:
    """Resume the run at its bench, and return the questions that were asked too."""
    watched = at.opened.rig.operator = Watched(at.opened.rig.operator, declines=declines)
    outcome, run = at.resume(open_run(at.recorder.path), anew=False)
    return outcome, run, [type(request).__name__ for request in watched.asked]


@pytest.mark.parametrize(("declines", "questions"), [((), UNCHANGED), (ConfirmUnchanged, CHANGED)])
def test_the_needle_is_withdrawn_along_its_path_before_anything_is_referenced(
    stopped: RunBench, declines: Declined, questions: list[str]
) -> None:
    """If the drives kept their references, a withdrawal is offered; what may have changed is asked for again."""
    outcome, run, asked = go_on(stopped, declines)
    assert (outcome.exit_status, asked) == ("success", questions)
    kinds = [event.get("request", event["kind"]) for event in run.lines("events")]
    start = kinds.index("run_resume")
    assert kinds[start + 1 : start + 4] == ["trial_stop", "WithdrawNeedle", "withdrawal_start"]
    assert list(run.trials["exit_status"]) == ["interrupted", "success"]


@pytest.mark.parametrize("is_referenced", [True, False])
def test_a_needle_that_is_not_withdrawn_is_asked_about(stopped: RunBench, is_referenced: bool) -> None:
    """The operator declines, or a drive has lost its reference: nothing moves until the needle is confirmed out."""
    rig = stopped.opened.rig
    depth_mm = rig.read_states()["insertion"].position
    if not is_referenced:
        rig.needle.forget_references(["linear"])
    outcome, _, asked = go_on(stopped, (WithdrawNeedle, ConfirmNeedleOut))
    assert asked == (["WithdrawNeedle"] if is_referenced else []) + ["ConfirmNeedleOut"]
    assert rig.read_states()["insertion"].position == depth_mm
    assert (outcome.exit_status, rig.state.needle_in_tissue) == ("aborted", True)


def test_a_run_that_was_stopped_before_its_first_insertion_goes_on_from_the_start(tmp_path: Path) -> None:
    """A run without any insertion is resumed with all of them, and no trial is marked as interrupted."""
    with bench(tmp_path, sweep()) as at:
        at.opened.rig.operator = Watched(at.opened.rig.operator, declines=MountNeedle)
        assert at.conduct(sweep())[0].exit_status == "aborted"
        at.opened.rig.operator = at.opened.hardware.operator
        outcome, run, _ = go_on(at)
    assert (outcome.exit_status, list(run.trials["exit_status"])) == ("success", ["success"])
