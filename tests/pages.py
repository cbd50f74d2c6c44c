"""Pages of runs, written as the commands write them."""

from datetime import datetime
from pathlib import Path

from labrig.analysis.result import AnyResult
from labrig.experiments.registry import find_run_experiment, load_run_protocol
from labrig.record.reader import Run
from labrig.report.page import Page, write_report


def write_page(run: Run, result: AnyResult | None, created: datetime) -> Path:
    """Write the page that the run's experiment makes of a result, and return its path."""
    experiment = find_run_experiment(run)
    protocol = load_run_protocol(run)
    page = (
        Page(experiment.part("TEMPLATE"))
        if result is None
        else experiment.part("make_page")(run, protocol, result)
    )
    kind, can_resume = experiment.title, bool(run.manifest.get("trials_planned"))
    return write_report(run, protocol, page, result, created, kind=kind, can_resume=can_resume)
