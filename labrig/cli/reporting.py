"""Writes the report page of a run."""

from pathlib import Path

from labrig.analysis.result import AnyResult
from labrig.devices.clocks import SystemClock
from labrig.experiments.registry import find_run_experiment, load_run_protocol
from labrig.plugins import require_devices_installed
from labrig.record.reader import Run
from labrig.report.writing import write_report


def write_page(run: Run, result: AnyResult | None, *, private: bool = False) -> Path:
    """Write `RUN/report.html` and return its path.

    Parameters
    ----------
    private : bool
        Leave out host, account, command line and the authors of notes.

    Raises
    ------
    InputError
        When the experiment of the run, or a drive or camera, is not installed.
    RecordError
        When record or result are so damaged that nothing can be shown.
    DiskError
        When the page cannot be written.
    """
    experiment = find_run_experiment(run)
    require_devices_installed(str(run.path), run.plugin_packages)
    if private:
        run, result = run.without_personal_data(), None if result is None else result.without_personal_data()
    page = experiment.page(run, load_run_protocol(run), result)
    return write_report(
        run,
        page,
        result,
        SystemClock().utc(),
        kind=experiment.title,
        can_resume=bool(run.manifest.get("trials_planned")),
    )
