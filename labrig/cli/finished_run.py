"""How a run ended, and how that is printed."""

import shlex

from labrig.analysis.result import TextTable
from labrig.cli.output import failure_document, print_json, print_line, print_table, quote, say, say_failure
from labrig.devices.needle_location import NeedleLocation
from labrig.errors import OperatorDeclinedError, TargetMissedError
from labrig.record.layout import FRAME_LINES, read_checksum
from labrig.runner.experiment import Experiment
from labrig.runner.whole_run import FinishedRun


def print_finished(finished: FinishedRun, experiment: Experiment | None) -> int:
    """Print how a run ended, and return the exit code; a withdrawal has no experiment, and is not measured."""
    error, result, needle = finished.outcome.error, finished.result, finished.needle
    checksum = read_checksum(finished.path)
    left_in = needle is not None and bool(needle.way_out)
    answer = result or {}
    says_no = answer.get("accepted") is False or answer.get("reached", True) is not True
    # Why a target was not reached is the result, which the page tells.
    is_told = says_no and isinstance(error, TargetMissedError) and finished.report is not None
    if needle is not None and (left_in or error is not None):
        say_where_needle_is(needle.location)
    if error is not None and not is_told:
        # After a no, the one next step is to continue, where that is possible.
        declined = isinstance(error, OperatorDeclinedError) and finished.can_resume
        say_failure(error.reword(error.message, "") if declined else error)
    if needle is not None and left_in:
        say(f"then: {needle.way_out}")
    if error is not None and result is None:
        frames = finished.path / FRAME_LINES
        has_pictures = frames.is_file() and frames.stat().st_size > 0
        _say_what_is_left(finished, measurable=experiment is not None and has_pictures)
    print_json({
        "run": str(finished.path),
        "exit_status": finished.outcome.exit_status,
        "reason": finished.outcome.reason or None,
        "report": None if finished.report is None else str(finished.report),
        "result": result,
        "checksum": checksum,
        "needle": None if needle is None else needle.document(),
        **({} if error is None else {"error": failure_document(error)}),
    })  # fmt: skip
    if result is not None and experiment is not None and finished.report is not None:
        quote(finished.report)
        if error is not None and is_told:
            say_failure(error, is_told=True)
        for line in experiment.part("summarise")(result):
            if isinstance(line, TextTable):
                print_table(line.heads, line.rows)
            else:
                print_line(line)
        print_line(f"record  {finished.path}\nreport  {finished.report}")
    if checksum is not None:
        what = "write it in your notebook; it is the SHA-256 of the run's SHA256SUMS"
        print_line(f"checksum {checksum}\n         {what}")
    return int(says_no) if error is None else error.exit_code


def _say_what_is_left(finished: FinishedRun, *, measurable: bool) -> None:
    """Say what can be done with a record that was not measured."""
    place = shlex.quote(str(finished.path))
    say(f"the record is kept: {finished.path}")
    if measurable:
        say(f"measure what it holds: labrig reanalyze {place}")
    if finished.report is not None:
        say(f"what happened: {finished.report}")
    if finished.outcome.exit_status != "success" and finished.can_resume:
        say(f"continue it: labrig resume {place}")


def say_where_needle_is(location: NeedleLocation) -> None:
    """Say what the needle is doing, and where it is."""
    say(f"needle: {location.motion}\npositions: {location.where}")
