"""Several runs analysed at once."""

import platform
import shutil
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from pathlib import Path
from typing import Any, cast

import pytest

from labrig.analysis.divergence import compare_results
from labrig.analysis.engine import Pool, open_process_pool
from labrig.analysis.result import AnalysisResult
from labrig.analysis.run import Outcome, analyze_runs
from labrig.errors import FileFormatError, RecordError, WorkersError
from labrig.experiments.registry import find_run_experiment, load_run_result
from labrig.record.agreement import Verdict
from labrig.record.layout import MANIFEST
from labrig.record.reader import open_run
from tests.analysis.synthetic import NOW, PROVENANCE

FIRST = Path(__file__).parents[2] / "tests" / "records" / "steerability"


def analyze(runs: Sequence[Path], **options: Any) -> list[Outcome]:
    """Analyse runs on two processes; each comes with its outcome, in the order given."""
    with open_process_pool(2, "analysed runs") as pool:
        pairs = list(
            analyze_runs(runs, find_run_experiment, pool, created=NOW, provenance=PROVENANCE, **options)
        )
    assert [run for run, _ in pairs] == list(runs)
    return [outcome for _, outcome in pairs]


def test_each_run_gets_its_result_and_the_order_is_kept(tmp_path: Path) -> None:
    """Results stand in the order of the runs, each linked to its parent; a folder that is no run has its error."""
    runs = [Path(shutil.copytree(FIRST, tmp_path / name)) for name in ("a", "b", "c")]
    updates: list[tuple[int, int, str]] = []
    outcomes = analyze(
        [*runs, tmp_path / "none"], progress=lambda done, total, run: updates.append((done, total, run.name))
    )
    pictures = [len(open_run(run).pictures) for run in runs]
    assert updates == sorted(updates)
    assert [update for update in updates if update[0] == 0] == []
    assert updates[-1] == (sum(pictures) + 1, sum(pictures) + 1, "none")
    assert {update[2] for update in updates} == {"a", "b", "c", "none"}
    assert isinstance(outcomes[3], RecordError)
    results = [outcome for outcome in outcomes if isinstance(outcome, AnalysisResult)]
    assert [result.path for result in results] == [run / "analysis" / "002" for run in runs]
    assert [result.content.parent for result in results] == [1, 1, 1]
    for run, result in zip(runs, results, strict=True):
        read = load_run_result(open_run(run), 2)
        assert compare_results(read.document, results[0].document).verdict is Verdict.IDENTICAL
        assert compare_results(result.document, results[0].document).verdict is Verdict.IDENTICAL


def test_a_wrong_setting_is_told_for_each_run(tmp_path: Path) -> None:
    """An error with several places comes back whole from a worker process, for each run."""
    runs = [Path(shutil.copytree(FIRST, tmp_path / name)) for name in ("a", "b")]
    outcomes = analyze(runs, overrides=["analysis.window_start_mm=-1"])
    assert [type(outcome) for outcome in outcomes] == [FileFormatError, FileFormatError]
    assert all(isinstance(outcome, FileFormatError) and outcome.problems for outcome in outcomes)


class _FarPool(Pool):
    """A worker on a computer that does not have the manifest of a run."""

    def __init__(self, run: Path) -> None:
        super().__init__("analysed runs", cast("Any", self))
        self._run = run

    def submit(self, call: Callable[..., Any], /, *given: Any, **named: Any) -> "Future[Any]":
        """Do a call at once, without the manifest."""
        future: Future[Any] = Future()
        away = (self._run / MANIFEST).rename(self._run / "elsewhere.json")
        try:
            future.set_result(call(*given, **named))
        except WorkersError as error:
            future.set_exception(error)
        away.rename(self._run / MANIFEST)
        return future

    def count_workers(self) -> int:
        return 1

    def count_deaths(self, error: BaseException) -> None:
        """No worker dies."""

    def renew(self) -> None:
        """No worker is lost."""


def test_a_worker_that_does_not_see_a_run_ends_the_analysis(tmp_path: Path) -> None:
    """Its pictures would be called missing: the worker's computer and the run are named; it gets no result."""
    runs = [Path(shutil.copytree(FIRST, tmp_path / name)) for name in ("a", "b")]
    with pytest.raises(WorkersError, match=rf"{platform.node()} does not see {runs[0]}"):
        list(analyze_runs(runs, find_run_experiment, _FarPool(runs[0]), created=NOW, provenance=PROVENANCE))
    assert [path.name for path in (runs[0] / "analysis").iterdir()] == ["001"]
