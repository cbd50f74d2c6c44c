"""Prints the events of a run in words: of a record, or of a run that another process is making."""

from collections.abc import Mapping
from itertools import islice
from pathlib import Path
from typing import Any

from labrig.cli.damage import note_unused, report_damage
from labrig.cli.output import print_json, print_line, say
from labrig.devices.clocks import SystemClock
from labrig.errors import RecordError
from labrig.experiments.registry import follow_run
from labrig.record.following import GrowingRun
from labrig.record.reader import open_run
from labrig.report.event_words import LogEntry, describe_event

_TIME_COLUMNS = 11
_MARKS: Mapping[str, str] = {"ERROR": "! ", "WARN": "? "}


def print_log(path: Path, skip: int, *, every: bool, as_json: bool) -> int:
    """Print the events of a record behind the first `skip`, with `every` the details too; return the exit code."""
    run = open_run(path)
    words = follow_run(run).words
    entries = [(event, describe_event(event, words)) for event in run.lines("events")[skip:]]
    shown = [(event, entry) for event, entry in entries if _is_shown(entry, every)]
    note_unused(run.problems, run.damage)
    damage = report_damage(run.damage)
    if as_json:
        rows = [_make_row(event, entry) for event, entry in shown]
        print_json({"run": str(path), "events": rows, "reason": damage})
    else:
        for event, entry in shown:
            _print(event, entry)
        if not shown:
            say("no events")
    return 0 if damage is None else RecordError.exit_code


def follow_log(path: Path, skip: int, *, every: bool) -> None:
    """Print the events behind the first `skip` as they come, until no process writes the run any more.

    Raises
    ------
    RecordError
        When a line is damaged.
    """
    words = follow_run(open_run(path)).words
    followed = GrowingRun(path).follow(SystemClock())
    for event in islice((event for lines in followed for event in lines.events), skip, None):
        entry = describe_event(event, words)
        if _is_shown(entry, every):
            _print(event, entry)


def _is_shown(entry: LogEntry, every: bool) -> bool:
    return every or entry.level != "DEBUG"


def _make_row(event: Mapping[str, Any], entry: LogEntry) -> dict[str, object]:
    return {"t_s": event.get("t_s"), "kind": event.get("kind"), "level": entry.level, "text": entry.text}


def _print(event: Mapping[str, Any], entry: LogEntry) -> None:
    t_s = event.get("t_s")
    time = f"{t_s:.3f} s" if isinstance(t_s, int | float) else "-"
    print_line(f"{time:>{_TIME_COLUMNS}}  {_MARKS.get(entry.level, '')}{entry.text}", _TIME_COLUMNS + 2)
