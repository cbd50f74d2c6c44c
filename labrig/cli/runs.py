"""`labrig runs`: lists and searches the runs of a folder, shows one, verifies runs, and annotates them."""

import getpass
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from labrig.cli.options import (
    RunArgument,
    RunsArgument,
    RunsDirOption,
    find_runs_dir,
)
from labrig.cli.output import AsJson, print_json, print_line, print_table, say
from labrig.cli.several_runs import do_for_each_run
from labrig.errors import InputError, RecordError
from labrig.lab import choose_runs_dir, find_lab_folder
from labrig.text import format_count

app = typer.Typer()


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
        ),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """List every run of a folder that fits, damaged runs too; nothing is verified."""
    if context.invoked_subcommand is not None:
        return
    from labrig.record.catalogue import list_runs

    folder = find_runs_dir(runs_dir)
    every = list_runs(folder, where)
    if as_json:
        print_json([summary.document() for summary in every])
    elif every:
        _print_runs(every)
        from labrig.cli.next_steps import list_next_steps

        for line in list_next_steps(every):
            say(line)
    elif where is not None and list_runs(folder):
        say("no run matches")
    else:
        say(f"no runs in {folder}, {choose_runs_dir(runs_dir).reason}; {_suggest_first_run()}")


def _suggest_first_run() -> str:
    if find_lab_folder() is None:
        return "make a lab folder with example protocols: labrig init FOLDER"
    return "make the first with: labrig run steerability"


def _print_runs(listed: Sequence[Any]) -> None:
    """Print a table, with a column more for verdicts, notes and tags where there are any."""
    remarks: dict[str, list[object]] = {
        "verdict": [summary.verdict for summary in listed],
        "notes": [summary.notes or None for summary in listed],
        "tags": [", ".join(summary.tags) or None for summary in listed],
    }
    columns = {name: cells for name, cells in remarks.items() if any(cells)}
    rows = [_format_summary(summary) for summary in listed]
    print_table(
        ("run", "experiment", "exit status", "trials", *columns),
        [[*row, *cells] for row, *cells in zip(rows, *columns.values(), strict=True)],
    )


def _format_summary(summary: Any) -> list[object]:
    done, planned = summary.trials_done, summary.trials_planned
    trials = f"{done} of {planned}" if planned else None
    return [summary.run.name, summary.protocol, summary.exit_status, trials]


@app.command("show", help="Say what a run is and how it ended, and tell its events in words.")
def show_run(
    run: RunArgument,
    follow: Annotated[
        bool, typer.Option("--follow", help="Go on until the run has ended, with events as they come.")
    ] = False,
    as_json: AsJson = False,
) -> int:
    """Print rig time and a sentence for each event; exit with 4 when the record is damaged.

    Each move of an axis and each sighting of the tip stand only in what --json prints.
    """
    from labrig.cli.damage import report_damage
    from labrig.experiments.registry import follow_run
    from labrig.record.reader import open_run
    from labrig.report.event_words import describe_event

    if follow and as_json:
        raise InputError("--json prints one document, --follow lines as they come", "leave one of them out")
    opened = open_run(run)
    words = follow_run(opened).words
    if follow:
        _follow(opened.path, words)
        return 0
    told = [(event, describe_event(event, words)) for event in opened.lines("events")]
    damage = report_damage(opened.damage)
    if as_json:
        events = [
            {"t_s": event.get("t_s"), "kind": event.get("kind"), "level": entry.level, "text": entry.text}
            for event, entry in told
        ]
        keys = (
            "experiment",
            "title",
            "exit_status",
            "reason",
            "started",
            "ended",
            "trials_planned",
            "operator",
        )
        about = {key: opened.manifest.get(key) for key in keys}
        notes = asdict(opened.annotations)
        print_json(
            {"run": str(run), **about, **notes, "result": opened.result, "events": events, "damage": damage}
        )
    else:
        _print_about(opened)
        for event, entry in told:
            _print_event(event, entry)
    return 0 if damage is None else RecordError.exit_code


def _print_about(run: Any) -> None:
    """Print what a run is, how it ended, and what people say of it."""
    manifest, notes = run.manifest, run.annotations
    reason = f": {manifest['reason']}" if manifest.get("reason") else ""
    print_line(f"{run.path}: {manifest.get('experiment')}, {manifest['exit_status']}{reason}")
    print_line(f"  {manifest.get('title')}, started {manifest.get('started')}, ended {manifest.get('ended')}")
    if run.checksum is not None:
        print_line(f"  checksum {run.checksum}")
    if notes.tags or notes.verdict:
        print_line(f"  {' '.join(filter(None, (notes.verdict, *notes.tags)))}")
    for note in notes.notes:
        # Further lines of a note are indented, so that they cannot pass for output of labrig.
        print_line(f"  {note.at} {note.by}: " + note.text.replace("\n", "\n    "))


_MARKS: Mapping[str, str] = {"ERROR": "! ", "WARN": "? "}


def _print_event(event: Mapping[str, Any], entry: Any) -> None:
    if entry.level == "DEBUG":
        return
    t_s = event.get("t_s")
    time = f"{t_s:.3f} s" if isinstance(t_s, int | float) else "-"
    print_line(f"{time:>11}  {_MARKS.get(entry.level, '')}{entry.text}")


def _follow(path: Path, words: Any) -> None:
    """Print the events as they come, until no process writes the run any more."""
    from labrig.devices.clocks import SystemClock
    from labrig.record.following import GrowingRun
    from labrig.report.event_words import describe_event

    for lines in GrowingRun(path).follow(SystemClock()):
        for event in lines.events:
            _print_event(event, describe_event(event, words))


@app.command("check", help="Read every file of runs, and name what is missing, was changed or was added.")
def check(runs: RunsArgument, as_json: AsJson = False) -> int:
    """Exit with 0 when every run is sound, and with 4 when one is damaged."""

    def check_one(path: Path) -> Mapping[str, object]:
        from labrig.record.check import check_run

        found = check_run(path)
        if not as_json:
            _print_check(path, found)
        named = "; ".join(f"{problem.where}: {problem.message}" for problem in found.damage)
        return {
            "run": str(path),
            "ok": not found.damage,
            "reason": named or None,
            "protocol": found.experiment,
            "exit_status": found.exit_status,
            "writer": None if found.writer is None else str(found.writer),
            "damage": [asdict(problem) for problem in found.damage],
            "notices": [asdict(problem) for problem in found.notices],
            "frames": found.frames,
            "states": found.states,
            "events": found.events,
            "trials_done": found.trials_done,
        }

    return do_for_each_run(runs, check_one, as_json)


def _print_check(path: Path, found: Any) -> None:
    """Print what a run holds, and a line for each problem."""
    state = "interrupted" if found.exit_status == "incomplete" else f"closed as {found.exit_status}"
    state = state if found.writer is None else f"being written by {found.writer}"
    print_line(f"{path}: {'damaged' if found.damage else 'sound'}, {state}")
    counts = (
        format_count(found.frames, "frame"),
        format_count(found.states, "state"),
        format_count(found.events, "event"),
    )
    print_line(f"  it holds {', '.join(counts)}; {format_count(found.trials_done, 'trial')} done")
    for name, problems in (("damage", found.damage), ("note", found.notices)):
        for problem in problems:
            print_line(f"  {name}: {problem.where}: {problem.message}\n    hint: {problem.hint}")


@app.command("annotate", help="Tag runs, add a note to them, or judge whether they can be trusted.")
def annotate(
    runs: RunsArgument,
    tag: Annotated[list[str] | None, typer.Option(metavar="TAG", help="Add a tag; repeatable.")] = None,
    untag: Annotated[
        list[str] | None, typer.Option(metavar="TAG", help="Take a tag off; repeatable.")
    ] = None,
    note: Annotated[str | None, typer.Option(metavar="TEXT", help="Add a note.")] = None,
    verdict: Annotated[
        Literal["good", "doubtful", "bad"] | None,
        typer.Option(help="State whether they can be trusted; the last verdict counts."),
    ] = None,
    by: Annotated[
        str | None, typer.Option(metavar="NAME", help="Name of the author. Default: the account's.")
    ] = None,
    as_json: AsJson = False,
) -> int:
    """Write RUN/notes.json; what was recorded is not changed. Without an option print what is there."""
    from labrig.record.notes import annotate_run, read_annotations

    changes = bool(tag or untag or note is not None or verdict)

    def annotate_one(run: Path) -> Mapping[str, object]:
        if changes:
            author = _find_author(by)
            found = annotate_run(
                run, tags=tag or (), untag=untag or (), note=note, verdict=verdict, by=author
            )
        else:
            found = read_annotations(run)
        if changes and (run / "report.html").exists():
            say(f"note: {run}/report.html does not show this yet; write it again: labrig report {run}")
        if not as_json:
            told = (found.verdict, ", ".join(found.tags), format_count(len(found.notes), "note"))
            print_line(f"{run}: {'; '.join(filter(None, told))}")
        return asdict(found)

    return do_for_each_run(runs, annotate_one, as_json)


def _find_author(by: str | None) -> str:
    try:
        return by or getpass.getuser()
    except (OSError, KeyError) as error:
        raise InputError("this account has no name", "say who you are with --by NAME") from error
