"""A synthetic sweep, recorded and measured once for all tests that only read it."""

from dataclasses import dataclass
from typing import Any

import pytest

from labrig.analysis.result import AnyResult
from labrig.analysis.run import analyze_run
from labrig.experiments.registry import find_run_experiment
from labrig.experiments.shared.curvature_result import CurvatureResult
from labrig.record.reader import Run, open_run
from tests.analysis.synthetic import NOW, PROVENANCE, SyntheticSweep, record_sweep

SWEEP = SyntheticSweep({"gel A": (28.0, 28.6), "=gel B": (27.0, 27.4)}, without_needle=frozenset({3}))


@dataclass(frozen=True)
class MeasuredRun:
    """A run and its result."""

    run: Run
    result: AnyResult

    @property
    def content(self) -> CurvatureResult:
        """The result as one of curvatures."""
        assert isinstance(self.result.content, CurvatureResult)
        return self.result.content


def measure(run: Run, *overrides: str, workers: int = 1, **options: Any) -> MeasuredRun:
    """Analyse a run, in this process unless there are several workers."""
    known = {"created": NOW, "provenance": PROVENANCE, "workers": workers, **options}
    result = analyze_run(run, find_run_experiment(run), overrides=overrides, **known)
    return MeasuredRun(open_run(run.path), result)


@pytest.fixture(scope="session")
def measured(tmp_path_factory: pytest.TempPathFactory) -> MeasuredRun:
    """Two insertions in each of two gels; the last picture shows no needle."""
    return measure(record_sweep(tmp_path_factory.mktemp("sweep"), SWEEP))
