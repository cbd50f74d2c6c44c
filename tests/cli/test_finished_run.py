"""The exit code of a run that ended by itself, by what its result says."""

import shutil
from pathlib import Path

import pytest

from labrig.cli.finished_run import print_finished
from labrig.experiments.registry import find_experiment
from labrig.runner.attendant import Attendant
from labrig.runner.conduct import Outcome
from labrig.runner.whole_run import FinishedRun, finish

RECORDS = Path(__file__).parents[1] / "records"


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
    assert print_finished(finished, None) == exit_code


class Interrupting(Attendant):
    """Presses Ctrl+C when it is told something."""

    def __init__(self, told: str) -> None:
        self._told = told

    def say(self, text: str) -> None:
        """Press it."""
        if text == self._told:
            raise KeyboardInterrupt


def test_ctrl_c_after_the_end_says_that_the_run_is_recorded(tmp_path: Path) -> None:
    """And which command writes the page; a result that was made is kept."""
    path = Path(shutil.copytree(RECORDS / "roll-zero", tmp_path / "run"))
    before = len(list((path / "analysis").iterdir()))
    ended = FinishedRun(path, Outcome("success", "", None))
    finished = finish(ended, find_experiment("roll-zero"), ("labrig",), Interrupting("writing the report"))
    assert "it is recorded; labrig reanalyze measures it and writes its page" in finished.outcome.reason
    assert (finished.outcome.exit_status, finished.report) == ("success", None)
    assert len(list((path / "analysis").iterdir())) == before + 1
