"""`labrig runs check`: whether records are whole, what is lost, and closing those that were interrupted."""

from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer

from labrig.cli.next_steps import can_resume
from labrig.cli.options import RunsArgument
from labrig.cli.output import AsJson, failure_lines, plural, print_json, print_line, say
from labrig.devices.clocks import SystemClock
from labrig.errors import LabrigError, Problem, RecordError


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
    rows = []
    exit_code = 0
    for path in run_paths:
        try:
            row = _one(path, repair)
        except LabrigError as error:
            row = {"run": str(path), "ok": False, "reason": error.message}
            exit_code = exit_code or error.exit_code
            for line in failure_lines(error):
                say(line)
        else:
            exit_code = exit_code or (0 if row["ok"] else RecordError.exit_code)
            if not as_json:
                _print(row)
        rows.append(row)
    if as_json:
        print_json(rows)
    return exit_code


def _one(path: Path, repair: bool) -> dict[str, Any]:
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
        "reason": _reason(verdict.damage),
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


def _reason(damage: Iterable[Problem]) -> str | None:
    return "; ".join(f"{problem.where}: {problem.message}" for problem in damage) or None


def _print(row: dict[str, Any]) -> None:
    """Print what a run holds, and a line for each thing that is wrong with it."""
    print_line(f"{row['run']}: {'sound' if row['ok'] else 'damaged'}, {_state(row)}")
    counts = (plural(row[key], key.removesuffix("s")) for key in ("frames", "states", "events"))
    print_line(f"  it holds {', '.join(counts)}; {plural(row['trials_done'], 'trial')} came to the end")
    for name in ("damage", "torn"):
        for problem in row[name]:
            print_line(f"  {name}: {problem['where']}: {problem['message']}")
            print_line(f"    hint: {problem['hint']}")


def _state(row: dict[str, Any]) -> str:
    if row["repaired"]:
        return f"interrupted; now closed as {row['exit_status']}"
    if row["writer"] is not None:
        return f"being written by {row['writer']}"
    if row["exit_status"] == "incomplete":
        goes_on = ", labrig resume goes on with it" if can_resume(row["protocol"]) else ""
        return f"interrupted; --repair closes it{goes_on}"
    return f"closed as {row['exit_status']}"
