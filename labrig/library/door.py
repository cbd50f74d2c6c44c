"""The door: what a notebook calls, and what the commands call; `labrig` hands all of it out.

>>> import labrig
>>> run = labrig.run("steerability", seed=3)
>>> run.measurements.plot.scatter("trial", "radius_mm")
>>> labrig.compare([run, labrig.open_run("last")])

A rig that asks a person is run at a terminal, by `labrig run`. Every error is a `labrig.errors.LabrigError`, which
names the thing, its value, the limit and a hint.
"""

import sys
from collections.abc import Generator, Sequence
from pathlib import Path
from typing import TypeAlias

from labrig.analysis.comparison import Comparison, compare_runs
from labrig.analysis.measurements import open_measured_runs
from labrig.analysis.result import AnyResult
from labrig.analysis.run import analyze_run, analyze_runs, name_damage
from labrig.devices.clocks import SystemClock
from labrig.errors import LabrigError, RecordError
from labrig.experiments.declared import find_experiment
from labrig.experiments.registry import find_run_experiment, load_run_protocol, load_run_result
from labrig.lab import choose_runs_dir
from labrig.library.checking import Checked, check_sources
from labrig.library.names import require_run_folder
from labrig.library.pools import open_pool
from labrig.library.resumption import resume_run
from labrig.library.sources import Sources
from labrig.library.specimens import require_usable_specimens
from labrig.record.difference import Difference, list_differences
from labrig.record.provenance import collect_provenance
from labrig.record.reader import Run
from labrig.record.reader import open_run as open_run_folder
from labrig.runner.attendant import Attendant
from labrig.runner.replay import Replay, replay_run, replay_work
from labrig.runner.run_record import RunOrder
from labrig.runner.whole_run import FinishedRun, perform, write_page
from labrig.text import format_count

AnyRun: TypeAlias = Run | Path | str
"""A run, its folder, its name in the folder of runs, or `last`."""

_SILENT = Attendant()


def open_run(run: AnyRun, *, runs_dir: Path | str | None = None) -> Run:
    """Open a run: by its folder, its name in the folder of runs, or as `last`, the newest there.

    Raises
    ------
    InputError
        When there is no run of that name; says which was probably meant.
    RecordError
        When it is no run, or its manifest is damaged.
    """
    if isinstance(run, Run):
        return run
    return open_run_folder(require_run_folder(Path(run), _find_runs_dir(runs_dir)))


def run(
    protocol: Path | str,
    *,
    rig: Path | str | None = None,
    seed: int | None = None,
    settings: Sequence[str] = (),
    runs_dir: Path | str | None = None,
    name: str | None = None,
) -> Run:
    """Run a protocol on a rig, measure it, write its page, and return the run.

    Parameters
    ----------
    protocol : Path or str
        Its file, or its name in the lab folder.
    rig : Path, str or None
        The rig file; None: that of the environment, or the simulated rig of the lab folder.
    seed : int or None
        Takes the place of the protocol's seed.
    settings : sequence of str
        `dotted.key=value` each: values of the protocol, and with the prefix `rig.` of the rig file.
    runs_dir : Path, str or None
        Folder of runs; None: `data/runs` of the lab folder.
    name : str or None
        Name of the run's folder; None: UTC time and experiment.

    Raises
    ------
    LabrigError
        When it cannot begin; and as it ended, when it did not succeed: its record is kept.
    """
    sources = Sources.of(protocol, rig, settings, seed)
    return _open_finished(make_run(sources, _find_runs_dir(runs_dir), name))


def make_run(
    sources: Sources,
    runs_dir: Path,
    name: str | None = None,
    *,
    attendant: Attendant = _SILENT,
) -> FinishedRun:
    """Run a protocol as `run` does, for whoever attends it, and return how it ended.

    Raises
    ------
    LabrigError
        When it cannot begin.
    """
    protocol, rig = sources.load()
    protocol = require_usable_specimens(protocol, rig, runs_dir, SystemClock().utc(), attendant.say)
    order = RunOrder(
        find_experiment(protocol.experiment),
        protocol,
        rig,
        runs_dir,
        name,
        _read_command_line(),
        sources.document(has_rig=rig is not None),
    )
    return perform(order, attendant)


def resume(run: AnyRun, *, rig: Path | str | None = None) -> Run:
    """Continue a run that was interrupted, with the protocol, rig and calibration that it began with; return it.

    `rig` is the rig file, if it has moved since.

    Raises
    ------
    LabrigError
        When it cannot be continued, nothing is changed then; and as it ended, when it did not succeed.
    """
    rig_file = None if rig is None else Path(rig)
    return _open_finished(resume_run(open_run(run).path, rig_file, _read_command_line(), _SILENT))


def check(
    protocol: Path | str,
    *,
    rig: Path | str | None = None,
    seed: int | None = None,
    settings: Sequence[str] = (),
    runs_dir: Path | str | None = None,
) -> Checked:
    """Say whether a protocol can run on a rig, how long it takes, and what it needs; nothing moves.

    Takes what `run` takes.

    Raises
    ------
    FileFormatError
        With every problem of protocol and rig file.
    """
    return check_sources(Sources.of(protocol, rig, settings, seed), _find_runs_dir(runs_dir))


def reanalyze(run: AnyRun, *, settings: Sequence[str] = (), attendant: Attendant = _SILENT) -> AnyResult:
    """Measure the pictures of a run again and write a new numbered result; the record stays as it is.

    Parameters
    ----------
    settings : sequence of str
        `dotted.key=value` each, of the sections of the protocol that may be changed afterwards: `analysis.*`.

    Raises
    ------
    InputError, FileFormatError
        When a setting cannot be changed.
    RecordError
        When what it is computed from is damaged.
    """
    opened = open_run(run)
    experiment = find_run_experiment(opened)
    with attendant.progress(f"analysing {opened.path.name}", 1.0) as progress:
        return analyze_run(
            opened,
            experiment,
            overrides=tuple(settings),
            progress=lambda done, total: progress(done / total, f"{done} of {total} {experiment.counts}"),
            created=SystemClock().utc(),
            provenance=collect_provenance(_read_command_line()),
        )


def reanalyze_runs(
    runs: Sequence[Path],
    *,
    settings: Sequence[str] = (),
    workers: int | None = None,
    attendant: Attendant = _SILENT,
) -> Generator[tuple[Path, AnyResult | LabrigError], None, None]:
    """Measure several runs at once, as `reanalyze` does, and yield each with its result as it comes, or its error."""
    title = f"analysing {format_count(len(runs), 'run')}"
    with open_pool(workers, None, "analysed runs") as pool, attendant.progress(title, 1.0) as progress:
        yield from analyze_runs(
            runs,
            find_run_experiment,
            pool,
            overrides=settings,
            progress=lambda done, of, run: progress(done / of, f"{done} of {of} pictures, {run.name}"),
            created=SystemClock().utc(),
            provenance=collect_provenance(_read_command_line()),
        )


def replay(run: AnyRun, *, attendant: Attendant = _SILENT) -> Replay:
    """Repeat the procedure of a run with its recorded answers, and say whether it decides the same again.

    Raises
    ------
    InputError
        For a run that no procedure made.
    RecordError
        When the record is damaged.
    """
    opened = open_run(run)
    for problem in opened.damage:
        message = f"{opened.path} is damaged: {problem.where}: {problem.message}"
        raise RecordError(message, "see: labrig runs check")
    experiment, protocol = find_run_experiment(opened), load_run_protocol(opened)
    work = replay_work(opened, experiment)
    with attendant.progress(f"replaying {opened.path.name}", work) as progress:
        return replay_run(opened, experiment, protocol, progress)


def compare(runs: Sequence[AnyRun], *, quantity: str | None = None, by: Sequence[str] = ()) -> Comparison:
    """Compare the newest results of runs, group by group: means, intervals and tests.

    Parameters
    ----------
    quantity : str or None
        A column of the results' tables; None: `radius_mm`, else `target_error_mm`.
    by : sequence of str
        Fields to group by; none: needle and gel.

    Raises
    ------
    InputError
        When they have nothing to compare.
    RecordError
        When none of them can be read.
    """
    measured, left_out = open_measured_runs([open_run(run).path for run in runs])
    if not measured and left_out:
        raise left_out[0].error
    return compare_runs(measured, left_out, quantity=quantity, by=by).comparison


def write_report(run: AnyRun, *, result: int | None = None) -> Path:
    """Write the page of a run again, from its newest result or that number, and return its path.

    Raises
    ------
    InputError
        When the run has no result of that number.
    RecordError
        When record or result are so damaged that nothing can be shown.
    """
    opened = open_run(run)
    with name_damage(opened.path, opened.damage):
        return write_page(opened, find_run_experiment(opened), load_run_result(opened, result))


def view(run: AnyRun, *, attendant: Attendant = _SILENT) -> Path:
    """Write RUN/view.rrd, which the rerun viewer opens, and return its path. Raises `RecordError`."""
    # Imported late, as the viewer's library is large.
    from labrig.library.view_file import make_view_file

    return make_view_file(open_run(run), attendant.say)


def differences(a: AnyRun, b: AnyRun) -> tuple[Difference, ...]:
    """Return each value in which two runs differ: endings, protocols, rigs, calibrations, versions and results."""
    return list_differences(open_run(a), open_run(b))


def _open_finished(finished: FinishedRun) -> Run:
    """Return a finished run. Raises the error that ended it."""
    error = finished.outcome.error
    if error is not None:
        raise error.reword(f"{error.message}; its record is kept: {finished.path}")
    return open_run_folder(finished.path)


def _find_runs_dir(given: Path | str | None) -> Path:
    return choose_runs_dir(None if given is None else Path(given)).path


def _read_command_line() -> tuple[str, ...]:
    """Return what was typed; of a notebook or a prompt, whose arguments say nothing, the name of the program."""
    return tuple(sys.argv[:1] if hasattr(sys, "ps1") else sys.argv) or ("python",)
