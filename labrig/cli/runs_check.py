"""`labrig runs check`: verifies records, reports what is lost, and closes runs that were interrupted."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from string import hexdigits
from typing import Annotated, TypedDict

import typer

from labrig.cli.next_steps import can_resume
from labrig.cli.options import RunsArgument
from labrig.cli.output import AsJson, print_line
from labrig.cli.several_runs import do_for_each_run
from labrig.devices.clocks import SystemClock
from labrig.errors import InputError, Problem
from labrig.record.chain import Link, find_link
from labrig.text import format_count


class _ShownLink(TypedDict):
    """A link of the chain, as --json prints it."""

    link: int
    kind: str
    at: str | None
    files: list[str]


class _CheckedRun(TypedDict):
    """What was found of a run, as --json prints it."""

    run: str
    ok: bool
    reason: str | None
    protocol: str | None
    exit_status: str | None
    writer: str | None
    repaired: bool
    seal: str
    root: str | None
    newest_link: str | None
    after_root: list[_ShownLink] | None
    damage: list[dict[str, str]]
    torn: list[dict[str, str]]
    notices: list[dict[str, str]]
    frames: int
    states: int
    events: int
    trials_done: int


def check(
    run_paths: RunsArgument,
    repair: Annotated[
        bool,
        typer.Option(
            "--repair", help="Close interrupted runs; torn ends are moved aside, nothing is deleted."
        ),
    ] = False,
    root: Annotated[
        str | None,
        typer.Option(
            metavar="HASH",
            help="Hash of a link that was written down, or its first 16 digits: exit with 4 when the chain does not "
            "hold it, else list what was added after it.",
            show_default=False,
        ),
    ] = None,
    as_json: AsJson = False,
) -> int:
    """Exit with 0 when every run is sound, and with 4 when one is damaged."""
    digits = None if root is None else _parse_root(root, run_paths)

    def check_and_print(path: Path) -> Mapping[str, object]:
        checked = _check_run(path, repair, digits)
        if not as_json:
            _print(checked)
        return checked

    return do_for_each_run(run_paths, check_and_print, as_json)


_LEAST_DIGITS, _MOST_DIGITS = 16, 64


def _parse_root(root: str, run_paths: Sequence[Path]) -> str:
    """Return the digits of a hash that somebody typed. Raises `InputError`."""
    digits = "".join(root.split()).lower()
    if len(run_paths) != 1:
        raise InputError(
            f"--root is the hash of one run, and {len(run_paths)} are named", "check them one by one"
        )
    if not _LEAST_DIGITS <= len(digits) <= _MOST_DIGITS or set(digits) - set(hexdigits):
        raise InputError(
            f"--root {root!r} is no hash",
            f"give its {_MOST_DIGITS} hexadecimal digits, or the first {_LEAST_DIGITS}",
        )
    return digits


def _check_run(path: Path, repair: bool, root: str | None) -> _CheckedRun:
    from labrig.record.check import check_run
    from labrig.record.reader import fetch_folder
    from labrig.record.repair import repair_run
    from labrig.record.urls import require_local_run, restore_url

    if repair:
        require_local_run(path)
    folder = fetch_folder(path)
    verdict = check_run(folder)
    repaired = repair and not verdict.damage and repair_run(folder, SystemClock().utc())
    if repaired:
        verdict = check_run(folder)
    damage, known = list(verdict.damage), None if root is None else find_link(verdict.links, root)
    if root is not None and known is None:
        damage.append(Problem("chain.jsonl", f"no link of it has the hash {root}", _NOT_IN_CHAIN))
    return {
        "run": restore_url(path),
        "ok": not damage,
        "reason": _join(damage),
        "protocol": verdict.experiment,
        "exit_status": verdict.exit_status,
        "writer": None if verdict.writer is None else str(verdict.writer),
        "repaired": repaired,
        "seal": verdict.seal,
        "root": None if verdict.root is None else verdict.root.sha256,
        "newest_link": verdict.links[-1].sha256 if verdict.links else None,
        "after_root": None if known is None else [_show(link) for link in verdict.links[known.number :]],
        "damage": [asdict(problem) for problem in damage],
        "torn": [asdict(problem) for problem in verdict.torn],
        "notices": [asdict(problem) for problem in verdict.notices],
        "frames": verdict.frames,
        "states": verdict.states,
        "events": verdict.events,
        "trials_done": verdict.trials_done,
    }


_NOT_IN_CHAIN = "the chain was written anew since the hash was written down, or it is the hash of another run"


def _show(link: Link) -> _ShownLink:
    return {"link": link.number, "kind": link.kind, "at": link.at, "files": sorted(link.files)}


def _join(damage: Iterable[Problem]) -> str | None:
    return "; ".join(f"{problem.where}: {problem.message}" for problem in damage) or None


def _print(row: _CheckedRun) -> None:
    """Print what a run holds, and a line for each problem."""
    print_line(f"{row['run']}: {'sound' if row['ok'] else 'damaged'}, {_describe_state(row)}")
    counts = (
        format_count(row["frames"], "frame"),
        format_count(row["states"], "state"),
        format_count(row["events"], "event"),
    )
    print_line(f"  it holds {', '.join(counts)}; {format_count(row['trials_done'], 'trial')} done")
    _print_seal(row)
    for name, problems in (("damage", row["damage"]), ("torn", row["torn"]), ("note", row["notices"])):
        for problem in problems:
            print_line(f"  {name}: {problem['where']}: {problem['message']}", 4)
            print_line(f"    hint: {problem['hint']}", 6)


def _print_seal(row: _CheckedRun) -> None:
    """Print whether the run is sealed, its root, and what came after the root that was asked for."""
    if row["root"] is None:
        print_line(f"  seal: {row['seal']}")
    else:
        print_line(f"  seal: {row['seal']}; root, to be compared with a notebook:")
        print_line(f"    {row['root']}")
    if row["after_root"] == []:
        print_line("  nothing was added after the link that --root names")
    elif row["after_root"]:
        print_line("  added after the link that --root names:")
    for link in row["after_root"] or ():
        covers = ", ".join(sorted({name.rpartition("/")[0] or name for name in link["files"]})) or "no file"
        print_line(f"    link {link['link']}, {link['kind']}, {link['at'] or 'time unknown'}: {covers}", 6)


def _describe_state(row: _CheckedRun) -> str:
    if row["repaired"]:
        return f"interrupted; now closed as {row['exit_status']}"
    if row["writer"] is not None:
        return f"being written by {row['writer']}"
    if row["exit_status"] == "incomplete":
        resume = ", labrig resume continues it" if can_resume(row["protocol"]) else ""
        return f"interrupted; --repair closes it{resume}"
    return f"closed as {row['exit_status']}"
