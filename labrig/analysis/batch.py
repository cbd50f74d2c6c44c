"""Analyse many runs at once with the same workers; the results are those of one run after another."""

import platform
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import closing
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Any

from labrig.analysis.engine import Pool, run_in_order
from labrig.analysis.experiment import MeasuredExperiment
from labrig.analysis.result import AnyResult
from labrig.analysis.run import analyze_run
from labrig.errors import LabrigError, RecordError, WorkersError
from labrig.record.layout import MANIFEST
from labrig.record.pictures import count_pictures
from labrig.record.reader import Run, open_run

RunsProgress = Callable[[int, int, Path], None]
ExperimentOf = Callable[[Run], MeasuredExperiment]
Outcome = AnyResult | LabrigError


def analyze_runs(
    runs: Sequence[Path],
    find_experiment: ExperimentOf,
    pool: Pool,
    *,
    overrides: Sequence[str] = (),
    progress: RunsProgress | None = None,
    created: datetime,
    provenance: Mapping[str, Any],
) -> Generator[tuple[Path, Outcome], None, None]:
    """Analyse runs, each into a new numbered result; a failure does not stop the others.

    Each worker analyses whole runs, so that memory does not grow with their number.

    Parameters
    ----------
    runs : sequence of Path
        Their folders, each once.
    find_experiment : callable
        Returns the experiment of a run; it is pickled by name.
    pool : Pool
        The workers. Those of a cluster read and write the same folders, by absolute paths.
    progress : callable or None
        Called with the number of finished pictures, the number in all runs, and the run at hand. A run without
        pictures, such as a design, counts as one.
    overrides, created, provenance
        As for `analyze_run`.

    Yields
    ------
    tuple
        Each run, in the order given, and its result, or the error; a `MachineError` where workers die of a run again.

    Raises
    ------
    WorkersError
        When the pool can do no further task, or a worker does not see a run. What is done stays done.
    """
    task = partial(
        _analyze,
        find_experiment=find_experiment,
        overrides=tuple(overrides),
        created=created,
        provenance=dict(provenance),
    )
    sizes = [max(1, count_pictures(run)) for run in runs]
    done = 0
    there = {run for run in runs if (run / MANIFEST).is_file()}
    with closing(run_in_order(pool, task, (run for run in runs if run in there))) as outcomes:
        for run, size in zip(runs, sizes, strict=True):
            outcome = next(outcomes) if run in there else _explain_absence(run)
            done += size
            if progress is not None:
                progress(done, sum(sizes), run)
            yield run, outcome


def _explain_absence(run: Path) -> LabrigError:
    """Return the error of a folder that is no run."""
    try:
        open_run(run)
    except LabrigError as error:
        return error
    return RecordError(f"{run} has just lost its {MANIFEST}", "look whether somebody is moving it")


def _analyze(
    run: Path,
    *,
    find_experiment: ExperimentOf,
    overrides: Sequence[str],
    created: datetime,
    provenance: Mapping[str, Any],
) -> AnyResult:
    """Analyse a run in a worker."""
    _require_run(run)
    opened = open_run(run)
    return analyze_run(
        opened,
        find_experiment(opened),
        overrides=overrides,
        workers=1,
        created=created,
        provenance=provenance,
    )


def _require_run(run: Path) -> None:
    """Refuse to go on in a worker that does not see a run: each of its pictures would be called missing.

    Raises
    ------
    WorkersError
        Names the worker's computer and the run.
    """
    if not (run / MANIFEST).is_file():
        raise WorkersError(
            f"a worker on {platform.node()} does not see {run / MANIFEST}",
            "keep runs in a folder that this computer and all workers have under the same name",
        )
