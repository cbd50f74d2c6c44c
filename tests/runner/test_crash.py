"""SIGKILL at random moments of a run; `python -m tests.benchmarks crash` tries two hundred."""

from pathlib import Path

import pytest

from tests.benchmarks.crash import kill_runs


def test_killed_sweeps_lose_nothing_and_go_on(tmp_path: Path) -> None:
    """Each killed sweep keeps all acknowledged data, and resumed it gives the results of an unkilled one."""
    killed = list(kill_runs("steerability", 6, seed=11, folder=tmp_path))
    assert [(run.unhurt, run.resumed) for run in killed] == [(True, True)] * 6


@pytest.mark.parametrize("name", ["insertion", "roll-zero", "calibration"])
def test_other_killed_runs_lose_nothing_and_are_repaired(name: str, tmp_path: Path) -> None:
    """Each killed run keeps all acknowledged data, and is sound once it is closed."""
    killed = list(kill_runs(name, 2, seed=11, folder=tmp_path))
    assert [(run.unhurt, run.repaired) for run in killed] == [(True, True)] * 2
