"""The exit code of a run that ended by itself, by what its result says."""

from pathlib import Path

import pytest

from labrig.cli.finished_run import print_finished
from labrig.experiments.registry import find_experiment
from labrig.runner.conduct import Outcome
from labrig.runner.whole_run import FinishedRun


@pytest.mark.parametrize(
    ("result", "exit_code"),
    [
        ({"reached": True}, 0),
        ({"reached": False}, 1),
        ({"reached": None}, 1),
        ({"accepted": False}, 1),
        ({"accepted": True}, 0),
        ({"mean_radius_mm": 27.7}, 0),
    ],
)
def test_only_a_result_that_says_yes_ends_with_zero(
    result: dict[str, object], exit_code: int, tmp_path: Path
) -> None:
    """A target that is not known to have been reached is no success, nor is one that was missed."""
    finished = FinishedRun(tmp_path, Outcome("success", "", None), result=result)
    assert print_finished(finished, find_experiment("insertion"), as_json=True) == exit_code
