"""`labrig runs`: lists, searches, compares and annotates the runs of a folder."""

import gc
import getpass
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from datetime import datetime
from pathlib import Path
from typing import Annotated, Literal

import typer

from labrig.cli.damage import note_unused, report_damage
from labrig.cli.next_steps import list_next_steps
from labrig.cli.options import (
    LocalRunArgument,
    LocalRunsArgument,
    RunArgument,
    RunsDirOption,
    RunUrlArgument,
    find_runs_dir,
)
from labrig.cli.output import AsJson, format_cell, print_json, print_line, print_table, say
from labrig.cli.progress import show_working
from labrig.cli.runs_check import check
from labrig.cli.runs_log import log
from labrig.devices.clocks import SystemClock
from labrig.errors import InputError, Problem, RecordError
from labrig.lab import choose_runs_dir, find_lab_folder
from labrig.record.annotations import Annotations, judge_run, note_on_run, tag_run
from labrig.record.catalogue import FoundRun, RunSummary, list_runs

app = typer.Typer()


app.command("check", help="Verify hashes, checksums and structure of runs, and report what is lost.")(check)

app.command("log", help="Print the events of a run in words; --follow those of a run that is being made.")(
    log
)


ByOption = Annotated[
    str | None,
    typer.Option(
        "--by", metavar="NAME", help="Name of the author. Default: the account's name.", show_default=False
    ),
]


@app.callback(invoke_without_command=True)
def list_(
    context: typer.Context,
    runs_dir: RunsDirOption = None,
    where: Annotated[
        str | None,
        typer.Option(
            metavar="CONDITION",
            help='List only runs that fit, such as "gelatin_percent=13 and exit_status=success". '
            "Operators: = != < <= > >= ~ (contains), and, or, not, brackets.",
            show_default=False,
        ),
    ] = None,
    sort: Annotated[
        str | None, typer.Option(metavar="FIELD", help="Sort by a field, smallest first.", show_default=False)
    ] = None,
    show: Annotated[
        list[str] | None,
        typer.Option(
            metavar="FIELD",
            help="A column more, such as mean_radius_mm or target_error_mm of the newest result; repeatable.",
            show_default=False,
        ),
    ] = None,
    reverse: Annotated[bool, typer.Option("--reverse", help="Reverse the order.")] = False,
    limit: Annotated[
        int | None,
        typer.Option(min=1, metavar="N", help="List only the first N of them.", show_default=False),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """List every run of a folder that fits, damaged runs too."""
    if context.invoked_subcommand is not None:
        return

    folder = find_runs_dir(runs_dir)
    with _no_collections():
        with show_working("reading the runs", shown=not as_json):
            every = _find(folder, where, sort, show or (), reverse)
        if as_json:
            print_json([_make_row(run) for run in every[:limit]])
        elif every:
            _print_list(every, limit)
        elif where is not None and list_runs(folder):
            say("no run matches")
        else:
            say(f"no runs in {folder}, {choose_runs_dir(runs_dir).reason}; {_suggest_first_run()}")


def _print_list(every: Sequence[FoundRun], limit: int | None) -> None:
    """Print the first runs, what to do about those that were never closed, and how many more match."""
    found = every[:limit]
    _print_runs(found)
    for line in list_next_steps([run.summary for run in found]):
        say(line)
    if len(found) < len(every):
        say(f"{len(every) - len(found)} more match")


@contextmanager
def _no_collections() -> Iterator[None]:
    """Collect no garbage during a list: it makes none, and collections take a tenth of the time of 5,000 runs."""
    gc.freeze()  # the modules stay until the end
    gc.disable()
    try:
        yield
    finally:
        gc.enable()


def _suggest_first_run() -> str:
    if find_lab_folder() is None:
        return "make a lab folder with example protocols: labrig init FOLDER"
    return "make the first with: labrig run steerability"


def _find(
    runs_dir: Path,
    where: str | None,
    sort: str | None,
    show: Sequence[str],
    reverse: bool,
) -> list[FoundRun]:
    """Find the runs that fit, or list all runs, which needs no YAML reader."""
    if where is None and sort is None and not show:
        return [FoundRun(summary, {}) for summary in list_runs(runs_dir, reverse=reverse)]
    from labrig.record.search import find_runs

    return find_runs(runs_dir, where, sort, show, reverse=reverse)


def _make_row(found: FoundRun) -> dict[str, object]:
    asked = {"fields": {name: list(values) for name, values in found.fields.items()}} if found.fields else {}
    return {**asdict(found.summary), "run": str(found.summary.run), **asked}


# Fields that have a column of their own.
_SHOWN = frozenset({"run", "exit_status", "experiment", "protocol", "tag", "verdict"})


def _print_runs(found: Sequence[FoundRun]) -> None:
    """Print a table, with an additional column for each field that was searched, sorted by or asked for.

    Verdict, notes and tags have columns too, or lines below each run if the terminal is too narrow.
    """
    asked = [name for name in found[0].fields if name not in _SHOWN]
    heads = ["run", "experiment", "exit status", "trials", *asked]
    rows = [[*_format_summary(run.summary), *(_join(run.fields[name]) for name in asked)] for run in found]
    remarks = [_format_remarks(run.summary) for run in found]
    wanted = [column for column in range(len(_REMARKS)) if any(cells[column] for cells in remarks)]
    wide_heads = [*heads, *(_REMARKS[column] for column in wanted)]
    wide = [[*row, *(cells[column] for column in wanted)] for row, cells in zip(rows, remarks, strict=True)]
    print_table(wide_heads, wide)


def _format_summary(summary: RunSummary) -> list[object]:
    done, planned = summary.trials_done, summary.trials_planned
    trials = f"{done} of {planned}" if planned else None
    return [summary.run.name, summary.protocol, summary.exit_status, trials]


_REMARKS = ("verdict", "notes", "tags")


def _format_remarks(summary: RunSummary) -> tuple[str | None, int | None, str | None]:
    return summary.verdict, summary.notes or None, ", ".join(summary.tags) or None


def _join(values: Sequence[object]) -> object:
    return values[0] if len(values) == 1 else ", ".join(map(format_cell, values)) or None


@app.command("tag", help="Add a tag to runs, or remove it with --remove.")
def tag(
    runs: LocalRunsArgument,
    tags: Annotated[list[str], typer.Option("--tag", "-t", metavar="TAG", help="The tag; repeatable.")],
    remove: Annotated[bool, typer.Option("--remove", help="Remove the tag.")] = False,
    by: ByOption = None,
    as_json: AsJson = False,
) -> None:
    """Append to RUN/notes.jsonl; the record itself is not changed."""
    at = _now()
    tagged = [(run, tag_run(run, tags, remove=remove, by=_find_author(by), at=at)) for run in runs]
    for run in runs:
        _note_older_page(run)
    if as_json:
        print_json([_make_annotation_row(run, annotations) for run, annotations in tagged])
        return
    for run, annotations in tagged:
        print_line(f"{run}: {', '.join(annotations.tags) or 'no tags'}")


@app.command(
    "note",
    help="Add a note, or revise one with --revise; without TEXT print all notes with their history.",
)
def note(
    run: RunArgument,
    text: Annotated[
        str | None, typer.Argument(metavar="[TEXT]", help="The note.", show_default=False)
    ] = None,
    revise: Annotated[
        int | None, typer.Option(metavar="N", help="Number of the note to revise.", show_default=False)
    ] = None,
    by: ByOption = None,
    as_json: AsJson = False,
) -> None:
    """Append to RUN/notes.jsonl; older revisions are kept."""
    from labrig.record.reader import open_run
    from labrig.record.urls import require_local_run

    if text is None:
        annotations = open_run(run).annotations
    else:
        require_local_run(run)
        annotations = note_on_run(run, text, revises=revise, by=_find_author(by), at=_now())
        _note_older_page(run)
    if as_json:
        print_json(_make_annotation_row(run, annotations))
        return
    for revision in annotations.revisions if text is None else annotations.notes:
        # Further lines of a note are indented, so that they cannot pass for output of labrig.
        text = revision.text.replace("\n", "\n    ")
        print_line(f"{revision.note}.{revision.revision}  {revision.at}  {revision.by}: {text}")


@app.command("verdict", help="State whether a run can be trusted; the last verdict counts.")
def verdict(
    run: LocalRunArgument,
    judgement: Annotated[
        Literal["good", "doubtful", "bad"], typer.Argument(metavar="good|doubtful|bad", help="The verdict.")
    ],
    reason: Annotated[str, typer.Option(help="Reason for the verdict.", show_default=False)] = "",
    by: ByOption = None,
    as_json: AsJson = False,
) -> None:
    """Append to RUN/notes.jsonl; earlier verdicts are kept."""
    annotations = judge_run(run, judgement, reason, by=_find_author(by), at=_now())
    _note_older_page(run)
    if as_json:
        print_json(_make_annotation_row(run, annotations))
    else:
        print_line(f"{run}: {annotations.verdict}" + (f" ({reason})" if reason else ""))


@app.command("diff", help="Compare two runs: protocol, rig, calibration, versions, devices and results.")
def diff(
    a: RunUrlArgument,
    b: RunUrlArgument,
    as_json: AsJson = False,
) -> int:
    """Print each value in which they differ; exit with 4 when a record is damaged."""
    from labrig.cli.difference_tables import print_differences
    from labrig.record.difference import compare_runs
    from labrig.record.reader import open_run

    runs = open_run(a, read_pictures=True), open_run(b, read_pictures=True)
    for run in runs:
        note_unused(run.problems, run.damage)
    differences = compare_runs(*(run.path for run in runs))
    damage = report_damage([*_list_damage(a, runs[0].damage), *_list_damage(b, runs[1].damage)])
    exit_code = 0 if damage is None else RecordError.exit_code
    if as_json:
        found = [asdict(difference) for difference in differences]
        print_json({"a": a, "b": b, "identical": not found, "differences": found, "reason": damage})
        return exit_code
    print_differences(differences)
    return exit_code


def _list_damage(name: str, damage: Sequence[Problem]) -> list[str]:
    return [f"{name}: {problem.where}: {problem.message}" for problem in damage]


def _make_annotation_row(run: Path, annotations: Annotations) -> dict[str, object]:
    return {"run": str(run), **asdict(annotations)}


def _note_older_page(run: Path) -> None:
    """Say that the report page of a run, if it has one, does not show the new remark."""
    if (run / "report.html").exists():
        say(f"note: {run}/report.html does not show this yet; write it again: labrig report {run}")


def _find_author(by: str | None) -> str:
    try:
        return by or getpass.getuser()
    except (OSError, KeyError) as error:
        raise InputError("this account has no name", "say who you are with --by NAME") from error


def _now() -> datetime:
    return SystemClock().utc()
