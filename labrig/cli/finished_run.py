"""How a run ended, and how that is printed."""

import shlex
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from labrig.analysis.summary import Summary, TextTable
from labrig.cli.needle_report import NeedleReport, say_way_out, say_where_needle_is
from labrig.cli.output import (
    failure_document,
    failure_lines,
    print_json,
    print_line,
    print_table,
    say,
)
from labrig.record.manifest import read_checksum
from labrig.runner.conduct import Outcome
from labrig.runner.experiment import Experiment


@dataclass(frozen=True)
class FinishedRun:
    """A run that has ended, on disk at `path`; `result` and `report` are None if it was not measured.

    `needle` says where the needle was left, None without a rig; `signal_name` is a signal that came after the end;
    `can_resume` says whether the run can be continued.
    """

    path: Path
    outcome: Outcome
    needle: NeedleReport | None = None
    signal_name: str | None = None
    can_resume: bool = False
    report: Path | None = None
    result: Mapping[str, object] | None = None


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
