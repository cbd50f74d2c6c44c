"""`labrig runs`: lists and searches the runs of a folder, shows one, verifies runs, and annotates them."""

import getpass
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any, Literal

import typer
from typer import Option

from labrig.cli.options import RunArgument, RunsArgument, RunsDirOption, WhereOption, find_runs_dir
from labrig.cli.output import print_json, print_line, print_problems, print_table, say
from labrig.cli.several_runs import do_for_each_run, report_damage
from labrig.errors import InputError, RecordError
from labrig.lab import choose_runs_dir, find_lab_folder
from labrig.library.names import SIMULATED_RIG
from labrig.text import format_count


def list_(context: typer.Context, runs_dir: RunsDirOption = None, where: WhereOption = None) -> None:
    """List every run of a folder that fits, damaged runs too; nothing is verified."""
    if context.invoked_subcommand is not None:
        return
    from labrig.record.catalogue import list_runs

    folder = find_runs_dir(runs_dir)
    every = list_runs(folder, where)
    print_json([summary.document() for summary in every])
    if every:
        _print_runs(every)
        from labrig.cli.next_steps import list_next_steps

        for line in list_next_steps(every):
            say(line)
    elif where is not None and list_runs(folder):
        say("no run matches")
    else:
        first = "make the first with: labrig run steerability"
        if find_lab_folder() is None:
            first = "make a lab folder with example protocols: labrig init FOLDER"
        say(f"no runs in {folder}, {choose_runs_dir(runs_dir).reason}; {first}")


def _print_runs(listed: Sequence[Any]) -> None:
    rows = [
        (
            summary.run.name,
            summary.exit_status,
            f"{summary.trials_done} of {summary.trials_planned}" if summary.trials_planned else None,
            ", ".join(filter(None, _tell_about(summary))),
        )
        for summary in listed
    ]
    print_table(("run", "exit status", "trials", "about"), rows, cuts_last=True)


def _tell_about(summary: Any) -> Iterator[str | None]:
    """Yield what tells a run from others: what its name leaves out, --set by the ends of keys, --seed, and notes."""
    protocol, seed = summary.sources.get("protocol") or summary.protocol or "", summary.sources.get("seed")
    rig = Path(summary.sources.get("rig") or SIMULATED_RIG)
    yield summary.verdict
    yield None if summary.run.name.endswith(Path(protocol).stem) else Path(protocol).stem
    yield None if rig.name == SIMULATED_RIG.name else f"rig {rig.stem}"
    yield from (re.sub(r"^[\w.]*\.", "", setting) for setting in summary.sources.get("settings", ()))
    yield None if seed is None else f"seed={seed}"
    yield from summary.tags
    yield format_count(summary.notes, "note") if summary.notes else None


_TOLD = ("experiment", "title", "exit_status", "reason", "started", "ended", "trials_planned", "operator")
_MARKS: Mapping[str, str] = {"ERROR": "! ", "WARN": "? "}


def show_run(run: RunArgument) -> int:
    """Print rig time and a sentence for each event; exit with 4 when the record is damaged.

    Each move of an axis and each sighting of the tip stand only in what --json prints.
    """
    from labrig.experiments.registry import follow_run
    from labrig.record.reader import open_run
    from labrig.report.event_words import describe_event

    opened = open_run(run)
    words = follow_run(opened).words
    told = [(event, describe_event(event, words)) for event in opened.lines("events")]
    damage = report_damage(opened.damage)
    print_json({
        "run": str(run),
        **{key: opened.manifest.get(key) for key in _TOLD},
        **asdict(opened.annotations),
        "result": opened.result,
        "events": [
            {"t_s": event.get("t_s"), "kind": event.get("kind"), "level": entry.level, "text": entry.text}
            for event, entry in told
        ],
        "damage": damage,
    })  # fmt: skip
    _print_about(opened)
    for event, entry in told:
        if entry.level != "DEBUG":
            t_s = event.get("t_s")
            time = f"{t_s:.3f} s" if isinstance(t_s, int | float) else "-"
            print_line(f"{time:>11}  {_MARKS.get(entry.level, '')}{entry.text}")
    return 0 if damage is None else RecordError.exit_code


def _print_about(run: Any) -> None:
    """Print what a run is, how it ended, and what people say of it."""
    manifest, notes = run.manifest, run.annotations
    reason = f": {manifest['reason']}" if manifest.get("reason") else ""
    print_line(f"{run.path}: {manifest.get('experiment')}, {manifest['exit_status']}{reason}")
    ended = f", ended {manifest['ended']}" if manifest.get("ended") else ""
    print_line(f"  {manifest.get('title')}, started {manifest.get('started')}{ended}")
    if run.checksum is not None:
        print_line(f"  checksum {run.checksum}")
    if notes.tags or notes.verdict:
        print_line(f"  {' '.join(filter(None, (notes.verdict, *notes.tags)))}")
    for note in notes.notes:
        # Further lines of a note are indented, so that they cannot pass for output of labrig.
        print_line(f"  {note.at} {note.by}: " + note.text.replace("\n", "\n    "))


def check(runs: RunsArgument) -> int:
    """Exit with 0 when every run is sound, and with 4 when one is damaged."""
    from labrig.record.check import check_run

    def check_one(path: Path) -> Mapping[str, object]:
        found = check_run(path)
        writer = None if found.writer is None else str(found.writer)
        state = "interrupted" if found.exit_status == "incomplete" else f"closed as {found.exit_status}"
        state = state if writer is None else f"being written by {writer}"
        print_line(f"{path}: {'damaged' if found.damage else 'sound'}, {state}")
        nouns = {"frames": "picture", "states": "state", "events": "event"}
        held = ", ".join(format_count(found.holds[key], noun) for key, noun in nouns.items())
        print_line(f"  it holds {held}; trials that succeeded and count: {found.holds['trials_done']}")
        print_problems(found.damage, "  damage: ")
        print_problems(found.notices, "  note: ")
        named = "; ".join(f"{problem.where}: {problem.message}" for problem in found.damage)
        told = {key: value for key, value in asdict(found).items() if key != "holds"}
        row = {**told, **found.holds, "run": str(path), "writer": writer}
        return {**row, "ok": not found.damage, "reason": named or None}

    return do_for_each_run(runs, check_one)


def annotate(
    runs: RunsArgument,
    tag: Annotated[list[str] | None, Option(metavar="TAG", help="Add a tag; repeatable.")] = None,
    untag: Annotated[list[str] | None, Option(metavar="TAG", help="Take a tag off; repeatable.")] = None,
    note: Annotated[str | None, Option(metavar="TEXT", help="Add a note.")] = None,
    verdict: Annotated[
        Literal["good", "doubtful", "bad"] | None,
        Option(help="State whether they can be trusted; the last verdict counts."),
    ] = None,
    by: Annotated[str | None, Option(metavar="NAME", help="The author. Default: the account's name.")] = None,
) -> int:
    """Write RUN/notes.json; what was recorded is not changed. Without an option print what is there."""
    from labrig.record.notes import annotate_run, read_annotations

    def annotate_one(run: Path) -> Mapping[str, object]:
        if tag or untag or note is not None or verdict:
            author = by or _find_account()
            annotate_run(run, tags=tag or (), untag=untag or (), note=note, verdict=verdict, by=author)
            if (run / "report.html").exists():
                say(f"note: {run}/report.html does not show this yet; write it again: labrig report {run}")
        found = read_annotations(run)
        told = (found.verdict, ", ".join(found.tags), format_count(len(found.notes), "note"))
        print_line(f"{run}: {'; '.join(filter(None, told))}")
        return asdict(found)

    return do_for_each_run(runs, annotate_one)


def _find_account() -> str:
    try:
        return getpass.getuser()
    except (OSError, KeyError) as error:
        raise InputError("this account has no name", "say who you are with --by NAME") from error
