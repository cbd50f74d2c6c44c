"""Several runs analysed at once, a process each; the results are those of one after another."""

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import as_completed
from datetime import datetime
from pathlib import Path
from typing import Any

from labrig.analysis.result import AnalysisResult
from labrig.analysis.run import analyze_run
from labrig.analysis.workers import DEFAULT_WORKERS, worker_processes
from labrig.errors import LabrigError
from labrig.record import open_run

RunsProgress = Callable[[int, int, Path], None]


def analyze_runs(
    runs: Sequence[Path],
    *,
    overrides: Sequence[str] = (),
    workers: int = DEFAULT_WORKERS,
    progress: RunsProgress | None = None,
    created: datetime,
    provenance: Mapping[str, Any],
) -> list[AnalysisResult | LabrigError]:
    """Analyse runs, each into a new numbered result; one that fails does not keep the others from theirs.

    Parameters
    ----------
    runs : sequence of Path
        Their folders, each once.
    progress : callable or None
        Called after each run with how many are done, how many there are, and which it was.
    overrides, created, provenance
        As `analyze_run` takes them.

    Returns
    -------
    list
        For each run in the order given its result, or why it has none.

    Raises
    ------
    MachineError
        When a worker process dies.
    """
    outcomes: dict[int, AnalysisResult | LabrigError] = {}
    with worker_processes(min(workers, len(runs)), "analysed runs") as pool:
        tasks = {
            pool.submit(_analyze, run, tuple(overrides), created, dict(provenance)): number
            for number, run in enumerate(runs)
        }
        for task in as_completed(tasks):
            outcomes[tasks[task]] = task.result()
            if progress is not None:
                progress(len(outcomes), len(runs), runs[tasks[task]])
    return [outcomes[number] for number in range(len(runs))]


def _analyze(
    run: Path, overrides: tuple[str, ...], created: datetime, provenance: Mapping[str, Any]
) -> AnalysisResult | LabrigError:
    try:
        return analyze_run(
            open_run(run), overrides=overrides, workers=1, created=created, provenance=provenance
        )
    except LabrigError as error:
        return error
