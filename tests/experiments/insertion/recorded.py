"""A short insertion on the simulated rig, conducted once for all tests that only read it."""

import json
import tempfile
from functools import cache
from pathlib import Path
from typing import Any

from labrig.experiments.insertion.result import InsertionResult
from labrig.record.reader import Run, open_run
from tests.experiments.insertion.test_procedure import analyse, conduct_insertion, insertion

FOLDER = tempfile.TemporaryDirectory(prefix="labrig-insertion-")  # gone with the process
OBSTACLE = "obstacles=[{position_mm: [0, 8, 18], radius_mm: 4}]"


@cache
def record_insertion(*overrides: str) -> Run:
    """Conduct an insertion past one obstacle in gel that disturbs it, with its title as people may write it."""
    folder, title = Path(tempfile.mkdtemp(dir=FOLDER.name)), "title=To <b>there</b>"
    _, run = conduct_insertion(folder, insertion(OBSTACLE, title, *overrides), ())
    return open_run(run.path)


@cache
def analyse_recorded(*overrides: str) -> InsertionResult:
    """Analyse what `record_insertion` conducts, once for all tests that only read the result."""
    return analyse(record_insertion(*overrides))


def observations(run: Run) -> list[dict[str, Any]]:
    """Return the observations as they were written."""
    lines = (run.path / "events.jsonl").read_text(encoding="utf-8").splitlines()
    return [event for event in map(json.loads, lines) if event["kind"] == "observation"]
