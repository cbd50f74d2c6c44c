"""SIGKILL at ten random moments of a sweep; `python -m tests.benchmarks crash` does two hundred."""

from pathlib import Path

from tests.benchmarks.crash import Survived, kill_sweeps


def test_killed_sweeps_lose_nothing_and_go_on(tmp_path: Path) -> None:
    """Each opens with all that was acknowledged, goes on to the full count, and gives the unkilled sweep's results."""
    unhurt = Survived(opened=True, nothing_lost=True, lines_unchanged=True, resumed=True, results_equal=True)
    assert list(kill_sweeps(10, seed=11, folder=tmp_path)) == [unhurt] * 10
