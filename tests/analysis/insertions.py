"""A short insertion on the simulated rig, conducted once for all tests that only read it."""

import json
import tempfile
from functools import cache
from pathlib import Path
from typing import Any

from labrig.analysis.run import analyze_run
from labrig.experiments.insertion.result import InsertionResult
from labrig.experiments.registry import find_run_experiment
from labrig.record.reader import Run, open_run
from tests.analysis.synthetic import NOW, PROVENANCE
from tests.experiments.insertion.test_procedure import conduct_insertion, insertion

OBSTACLE = "obstacles=[{position_mm: [0, 8, 18], radius_mm: 4}]"


@cache
def record_insertion(*overrides: str) -> Run:
    """Conduct an insertion past one obstacle in gel that disturbs it, with its title as people may write it."""
    folder = Path(tempfile.mkdtemp(prefix="labrig-insertion-"))
    protocol = insertion(OBSTACLE, "title=To <b>there</b>", *overrides)
    _, run = conduct_insertion(folder, protocol, ())
    return open_run(run.path)


def analyse(run: Run, *overrides: str) -> InsertionResult:
    """Analyse a run of insertions."""
    result = analyze_run(
        run, find_run_experiment(run), overrides=overrides, workers=1, created=NOW, provenance=PROVENANCE
    )
    assert isinstance(result.content, InsertionResult)
    return result.content


@cache
def analyse_recorded(*overrides: str) -> InsertionResult:
    """Analyse what `record_insertion` conducts, once for all tests that only read the result."""
    return analyse(record_insertion(*overrides))


def observations(run: Run) -> list[dict[str, Any]]:
    """Return the observations as they were written."""
    lines = (run.path / "events.jsonl").read_text(encoding="utf-8").splitlines()
    return [event for event in map(json.loads, lines) if event["kind"] == "observation"]
