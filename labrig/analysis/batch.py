"""Several runs analysed at once by the same processes; the results are those of one after another."""

from collections import deque
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from datetime import datetime
from functools import partial
from inspect import isgeneratorfunction
from pathlib import Path
from typing import Any

from labrig.analysis.experiment import MeasuredExperiment
from labrig.analysis.pictures import (
    Analysis,
    Part,
    PictureWork,
    Progress,
    concluded,
    handed_out,
    look_at,
    seen,
)
from labrig.analysis.result import AnyResult
from labrig.analysis.run import analysis_of, analyze_run
from labrig.analysis.workers import DEFAULT_WORKERS, worker_processes
from labrig.errors import LabrigError
from labrig.record.pictures import count_pictures
from labrig.record.reader import Run, open_run
from labrig.vision.mask import Mask

RunsProgress = Callable[[int, int, Path], None]
ExperimentOf = Callable[[Run], MeasuredExperiment]
Outcome = AnyResult | LabrigError

# Parts of the runs to come that are handed out while one is waited for, for each worker: it never runs dry while this
# process writes a result, and the runs that are open stay few.
_PARTS_AHEAD = 16


def analyze_runs(
    runs: Sequence[Path],
    experiment_of: ExperimentOf,
    *,
    overrides: Sequence[str] = (),
    workers: int = DEFAULT_WORKERS,
    progress: RunsProgress | None = None,
    created: datetime,
    provenance: Mapping[str, Any],
    mask: Mask | None = None,
) -> list[Outcome]:
    """Analyse runs, each into a new numbered result; one that fails does not keep the others from theirs.

    The pictures of all runs are measured by the same processes, so that all of them have work until the end, whether
    there is one long run among short ones or not.

    Parameters
    ----------
    runs : sequence of Path
        Their folders, each once.
    experiment_of : callable
        Gives the experiment of a run; it crosses to other processes by its name.
    progress : callable or None
        Called with how many pictures are done, how many the runs have together, and which run they are of. A run
        that has none, such as a design, counts as one.
    overrides, created, provenance, mask
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
    order = _Order(experiment_of, tuple(overrides), created, dict(provenance), mask)
    meter = _Meter(runs, progress)
    outcomes: list[Outcome] = []
    begun: deque[_Begun] = deque()
    with worker_processes(workers, "analysed runs") as pool:
        for run in runs:
            begun.append(_begin(run, order, pool))
            while sum(len(one.parts) for one in list(begun)[1:]) > _PARTS_AHEAD * workers:
                outcomes.append(_ended(begun.popleft(), meter))
        outcomes += [_ended(one, meter) for one in begun]
    return outcomes


@dataclass(frozen=True)
class _Order:
    """How every run is analysed."""

    experiment_of: ExperimentOf
    overrides: tuple[str, ...]
    created: datetime
    provenance: Mapping[str, Any]
    mask: Mask | None


@dataclass(frozen=True)
class _Begun:
    """A run whose parts have been handed out, and what makes an outcome of their answers."""

    parts: Sequence[Part]
    conclude: Callable[[Progress], Outcome]


class _Meter:
    """Tells how many of the pictures of all runs are done."""

    def __init__(self, runs: Sequence[Path], progress: RunsProgress | None) -> None:
        self._runs = deque((run, max(1, count_pictures(run))) for run in runs)
        self._total = sum(count for _, count in self._runs)
        self._done = 0
        self._progress = progress

    def report(self, done: int, of: int) -> None:
        """Take how much of the run that is waited for is done."""
        run, count = self._runs[0]
        if self._progress is not None:
            self._progress(self._done + count * done // of, self._total, run)

    def end_run(self) -> None:
        """Take that the run is done."""
        self.report(1, 1)
        self._done += self._runs.popleft()[1]


def _begin(run: Path, order: _Order, pool: Executor) -> _Begun:
    """Hand the parts of a run to the pool: some pictures each, or the run as a whole."""
    try:
        opened = open_run(run)
        experiment = order.experiment_of(opened)
        if not isgeneratorfunction(experiment.analyze):
            whole = pool.submit(_analyzed, run, order).result
            return _Begun([whole], lambda _: whole()[0])
        analysis = analysis_of(
            opened,
            experiment,
            overrides=order.overrides,
            created=order.created,
            provenance=order.provenance,
            mask=order.mask,
            workers=1,
            progress=None,
        )
        work = next(analysis)
    except LabrigError as error:
        return _Begun((), partial(_refused, error))
    parts = handed_out(work, pool)
    return _Begun(parts, partial(_concluded, analysis, work, parts))


def _ended(one: _Begun, meter: _Meter) -> Outcome:
    outcome = one.conclude(meter.report)
    meter.end_run()
    return outcome


def _concluded(
    analysis: Analysis[AnyResult], work: PictureWork, parts: Sequence[Part], progress: Progress
) -> Outcome:
    """Wait for the answers, and let the analysis go on with them."""
    try:
        return concluded(analysis, lambda more: look_at(more, 1, None), seen(work, parts, progress))
    except LabrigError as error:
        return error


def _refused(error: LabrigError, _: Progress) -> Outcome:
    return error


def _analyzed(run: Path, order: _Order) -> list[Outcome]:
    """Analyse a run as a whole, in a worker process."""
    try:
        opened = open_run(run)
        return [
            analyze_run(
                opened,
                order.experiment_of(opened),
                overrides=order.overrides,
                workers=1,
                created=order.created,
                provenance=order.provenance,
                mask=order.mask,
            )
        ]
    except LabrigError as error:
        return [error]
