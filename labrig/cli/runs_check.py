"""`labrig runs check`: verifies records, reports what is lost, and closes runs that were interrupted."""

from collections.abc import Iterable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, TypedDict

import typer

from labrig.cli.next_steps import can_resume
from labrig.cli.options import RunsArgument
from labrig.cli.output import AsJson, plural, print_line
from labrig.cli.several_runs import do_for_each_run
from labrig.devices.clocks import SystemClock
from labrig.errors import Problem


class _CheckedRun(TypedDict):
    """What was found of a run, as --json prints it."""

    run: str
    ok: bool
    reason: str | None
    protocol: str | None
    exit_status: str | None
    writer: str | None
    repaired: bool
    damage: list[dict[str, str]]
    torn: list[dict[str, str]]
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
    as_json: AsJson = False,
) -> int:
    """Exit with 0 when every run is sound, and with 4 when one is damaged."""

    def check_and_print(path: Path) -> Mapping[str, object]:
        checked = _check_run(path, repair)
        if not as_json:
            _print(checked)
        return checked

    return do_for_each_run(run_paths, check_and_print, as_json)


def _check_run(path: Path, repair: bool) -> _CheckedRun:
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
    return {
        "run": restore_url(path),
        "ok": not verdict.damage,
        "reason": _join(verdict.damage),
        "protocol": verdict.experiment,
        "exit_status": verdict.exit_status,
        "writer": None if verdict.writer is None else str(verdict.writer),
        "repaired": repaired,
        "damage": [asdict(problem) for problem in verdict.damage],
        "torn": [asdict(problem) for problem in verdict.torn],
        "frames": verdict.frames,
        "states": verdict.states,
        "events": verdict.events,
        "trials_done": verdict.trials_done,
    }


def _join(damage: Iterable[Problem]) -> str | None:
    return "; ".join(f"{problem.where}: {problem.message}" for problem in damage) or None


def _print(row: _CheckedRun) -> None:
    """Print what a run holds, and a line for each problem."""
    print_line(f"{row['run']}: {'sound' if row['ok'] else 'damaged'}, {_describe_state(row)}")
    counts = (plural(row["frames"], "frame"), plural(row["states"], "state"), plural(row["events"], "event"))
    print_line(f"  it holds {', '.join(counts)}; {plural(row['trials_done'], 'trial')} came to the end")
    for name, problems in (("damage", row["damage"]), ("torn", row["torn"])):
        for problem in problems:
            print_line(f"  {name}: {problem['where']}: {problem['message']}")
            print_line(f"    hint: {problem['hint']}")


def _describe_state(row: _CheckedRun) -> str:
    if row["repaired"]:
        return f"interrupted; now closed as {row['exit_status']}"
    if row["writer"] is not None:
        return f"being written by {row['writer']}"
    if row["exit_status"] == "incomplete":
        resume = ", labrig resume continues it" if can_resume(row["protocol"]) else ""
        return f"interrupted; --repair closes it{resume}"
    return f"closed as {row['exit_status']}"
