"""Analyse many runs at once with the same workers; the results are those of one run after another."""

import platform
from collections import deque
from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from functools import partial
from inspect import isgeneratorfunction
from pathlib import Path
from typing import Any

from labrig.analysis.engine import Pool, WorkQueue
from labrig.analysis.experiment import MeasuredExperiment
from labrig.analysis.pictures import (
    Analysis,
    Part,
    PictureWork,
    Progress,
    finish_analysis,
    gather_answers,
    measure_pictures,
    split_work,
)
from labrig.analysis.result import AnyResult
from labrig.analysis.run import AnalysisSettings, start_analysis
from labrig.errors import LabrigError, WorkersError
from labrig.record.layout import MANIFEST
from labrig.record.pictures import count_pictures
from labrig.record.reader import Run, open_run
from labrig.vision.mask import Mask

RunsProgress = Callable[[int, int, Path], None]
ExperimentOf = Callable[[Run], MeasuredExperiment]
Outcome = AnyResult | LabrigError

# Parts of later runs submitted for each worker while one run is waited for: no worker idles while this process writes a
# result, and few runs are open.
_PARTS_AHEAD = 16


def analyze_runs(
    runs: Sequence[Path],
    find_experiment: ExperimentOf,
    pool: Pool,
    *,
    overrides: Sequence[str] = (),
    progress: RunsProgress | None = None,
    created: datetime,
    provenance: Mapping[str, Any],
    mask: Mask | None = None,
) -> Generator[tuple[Path, Outcome], None, None]:
    """Analyse runs, each into a new numbered result; a failure does not stop the others.

    The same workers measure the pictures of all runs, so that each has work until the end, even with one long run among
    short ones. Few runs are open at a time, so that memory does not grow with them.

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
    overrides, created, provenance, mask
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
    settings = AnalysisSettings(tuple(overrides), created, dict(provenance), mask)
    meter = _ProgressMeter(runs, progress)
    started: deque[_StartedRun] = deque()
    queue = WorkQueue(pool)
    try:
        for run in runs:
            started.append(_start(run, find_experiment, settings, queue))
            while sum(len(later.parts) for later in list(started)[1:]) > _PARTS_AHEAD * pool.count_workers():
                yield _finish(started.popleft(), meter)
        while started:
            yield _finish(started.popleft(), meter)
    finally:
        queue.drop()


@dataclass(frozen=True)
class _StartedRun:
    """A run whose parts are submitted, and the call that makes an outcome of their answers."""

    run: Path
    parts: Sequence[Part]
    conclude: Callable[[Progress], Outcome]


class _ProgressMeter:
    """Reports how many of the pictures of all runs are done."""

    def __init__(self, runs: Sequence[Path], progress: RunsProgress | None) -> None:
        self._runs = deque((run, max(1, count_pictures(run))) for run in runs)
        self._total = sum(count for _, count in self._runs)
        self._done = 0
        self._progress = progress

    def report(self, done: int, of: int) -> None:
        """Report the progress of the run that is waited for."""
        run, count = self._runs[0]
        if self._progress is not None:
            self._progress(self._done + count * done // of, self._total, run)

    def end_run(self) -> None:
        """Report that the run is done."""
        self.report(1, 1)
        self._done += self._runs.popleft()[1]


def _start(
    run: Path, find_experiment: ExperimentOf, settings: AnalysisSettings, queue: WorkQueue
) -> _StartedRun:
    """Submit the parts of a run: a few pictures each, or the whole run."""
    try:
        opened = open_run(run, read_pictures=True)
        experiment = find_experiment(opened)
        if not isgeneratorfunction(experiment.analyze):
            wait = queue.begin(partial(_analyze_whole, run, find_experiment, settings))
            return _StartedRun(run, [lambda: [wait()]], lambda _: wait())
        analysis = start_analysis(opened, experiment, settings, workers=1, progress=None)
        work = next(analysis)
    except LabrigError as error:
        return _StartedRun(run, (), partial(_return_error, error))
    parts = [queue.begin(partial(_do_part, run, part)) for part in split_work(work)]
    return _StartedRun(run, parts, partial(_finish_measured, analysis, work, parts))


def _finish(started: _StartedRun, meter: _ProgressMeter) -> tuple[Path, Outcome]:
    """Return a run and its outcome. Raises `WorkersError`, which is no outcome of one run."""
    outcome: Outcome
    try:
        outcome = started.conclude(meter.report)
    except WorkersError:
        raise
    except LabrigError as error:
        outcome = error
    meter.end_run()
    return started.run, outcome


def _finish_measured(
    analysis: Analysis[AnyResult], work: PictureWork, parts: Sequence[Part], progress: Progress
) -> AnyResult:
    """Wait for the answers and continue the analysis with them."""
    answers = gather_answers(work, parts, progress)
    return finish_analysis(analysis, lambda more: measure_pictures(more, 1, None), answers)


def _return_error(error: LabrigError, _: Progress) -> Outcome:
    return error


def _analyze_whole(run: Path, find_experiment: ExperimentOf, settings: AnalysisSettings) -> AnyResult:
    """Analyse a run in a worker."""
    _require_run(run)
    opened = open_run(run, read_pictures=True)
    analysis = start_analysis(opened, find_experiment(opened), settings, workers=1, progress=None)
    return finish_analysis(analysis, lambda work: measure_pictures(work, 1, None))


def _do_part(run: Path, part: Part) -> list[Any]:
    """Do a part of a run's work in a worker."""
    _require_run(run)
    return part()


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
