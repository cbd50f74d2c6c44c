"""Runs and their pages, made once for all tests that only look at them."""

from dataclasses import dataclass

import pytest

from labrig.analysis.result import AnyResult
from labrig.analysis.run import analyze_run
from labrig.experiments.registry import find_run_experiment
from labrig.record.reader import Run, open_run
from tests.analysis.synthetic import NOW, PROVENANCE, SyntheticSweep, record_sweep
from tests.pages import write_page

HOSTILE = "<script>alert('x')</script> --> $x$ & \"gel\""


@dataclass(frozen=True)
class WrittenPage:
    """A run, its result and its page."""

    run: Run
    result: AnyResult | None
    html: str


def make_page(run: Run, *, analysed: bool = True) -> WrittenPage:
    """Analyse a run, unless told not to, and write its page."""
    result = (
        analyze_run(run, find_run_experiment(run), workers=1, created=NOW, provenance=PROVENANCE)
        if analysed
        else None
    )
    again = open_run(run.path)
    return WrittenPage(again, result, write_page(again, result, NOW).read_text(encoding="utf-8"))


@pytest.fixture(scope="session")
def page(tmp_path_factory: pytest.TempPathFactory) -> WrittenPage:
    """A sweep of two gels; the last picture shows no needle."""
    return make_page(
        record_sweep(tmp_path_factory.mktemp("page"), SyntheticSweep(without_needle=frozenset({3})))
    )
