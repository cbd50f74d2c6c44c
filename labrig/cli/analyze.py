"""Measures runs and shows progress: the run that has just ended, or old runs again."""

from collections.abc import Generator, Sequence
from contextlib import closing
from pathlib import Path

from labrig.analysis.batch import analyze_runs
from labrig.analysis.engine import open_process_pool
from labrig.analysis.result import AnyResult
from labrig.cli.progress import hold_bar, progress
from labrig.devices.clocks import SystemClock
from labrig.errors import LabrigError
from labrig.experiments.registry import find_run_experiment
from labrig.posix import count_usable_cores
from labrig.record.provenance import collect_provenance
from labrig.text import format_count


def analyze_several(
    runs: Sequence[Path],
    command_line: tuple[str, ...],
    overrides: tuple[str, ...],
    workers: int | None,
) -> Generator[tuple[Path, AnyResult | LabrigError], None, None]:
    """Analyse several runs at once, with progress, and yield each with its result as it comes, or with its error."""
    title = f"measuring {format_count(len(runs), 'run')}"
    with (
        open_process_pool(workers or count_usable_cores(), "analysed runs") as pool,
        progress(title, 1.0) as reporter,
    ):
        outcomes = analyze_runs(
            runs,
            find_run_experiment,
            pool,
            overrides=overrides,
            progress=lambda done, total, run: reporter(
                done / total, f"{done} of {total} pictures, {run.name}"
            ),
            created=SystemClock().utc(),
            provenance=collect_provenance(command_line),
        )
        with closing(outcomes):
            for outcome in outcomes:
                with hold_bar():
                    yield outcome
