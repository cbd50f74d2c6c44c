"""How a run ended, and how that is printed."""

import shlex

from labrig.analysis.result import Summary, TextTable
from labrig.cli.output import (
    failure_document,
    failure_lines,
    print_json,
    print_line,
    print_table,
    say,
)
from labrig.record.manifest import read_checksum
from labrig.runner.experiment import Experiment
from labrig.runner.needle_report import NeedleReport
from labrig.runner.whole_run import FinishedRun


def print_finished(finished: FinishedRun, experiment: Experiment, as_json: bool) -> int:
    """Print how a run ended, and return the exit code."""
    outcome, error = finished.outcome, finished.outcome.error
    checksum = read_checksum(finished.path)
    document: dict[str, object] = {
        "run": str(finished.path),
        "exit_status": outcome.exit_status,
        "reason": outcome.reason or None,
        "report": None if finished.report is None else str(finished.report),
        "result": finished.result,
        "checksum": checksum,
        "needle": None if finished.needle is None else finished.needle.document(),
    }
    place = shlex.quote(str(finished.path))
    if error is not None:
        document["error"] = failure_document(error)
        say_where_needle_is(finished.needle)
        for line in failure_lines(error):
            say(line)
        say_way_out(finished.needle)
        if finished.result is None:
            say(f"the record is kept: {finished.path}\nmeasure what it holds: labrig reanalyze {place}")
            if finished.report is not None:
                say(f"what happened: {finished.report}")
        if finished.result is None and outcome.exit_status != "success" and finished.can_resume:
            say(f"continue it: labrig resume {place}")
    if as_json:
        print_json(document)
    elif finished.result is not None:
        print_summary(experiment.summarise(finished.result))
        print_line(f"record  {finished.path}\nreport  {finished.report}")
    if checksum is not None and not as_json:
        print_line(
            f"checksum {checksum}\n         write it in your notebook; it is the SHA-256 of the run's SHA256SUMS"
        )
    if error is not None:
        return error.exit_code
    result = {} if finished.result is None else finished.result
    return 1 if result.get("accepted") is False or result.get("reached", True) is not True else 0


def print_summary(summary: Summary) -> None:
    """Print an experiment's summary of a result."""
    for line in summary.lines:
        if isinstance(line, TextTable):
            print_table(line.heads, line.rows)
        else:
            print_line(line)


def say_where_needle_is(report: NeedleReport | None) -> None:
    """Say what the needle is doing, and where it is."""
    if report is not None:
        say(f"needle: {report.location.motion}")
        say(f"positions: {report.location.where}")


def say_way_out(report: NeedleReport | None) -> None:
    """Say what to do about the needle, if there is anything to do."""
    if report is not None and report.way_out:
        say(f"then: {report.way_out}")
