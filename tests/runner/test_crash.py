"""SIGKILL at ten random moments of a sweep; `python -m tests.benchmarks crash` tries two hundred."""

from pathlib import Path

from tests.benchmarks.crash import Survived, kill_sweeps


def test_killed_sweeps_lose_nothing_and_go_on(tmp_path: Path) -> None:
    """Each killed sweep keeps all acknowledged data, and resumed it gives the results of an unkilled one."""
    unhurt = Survived(opened=True, nothing_lost=True, lines_unchanged=True, resumed=True, results_equal=True)
    assert list(kill_sweeps(10, seed=11, folder=tmp_path)) == [unhurt] * 10
