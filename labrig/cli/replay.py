"""`labrig replay`: the same procedure on recorded devices, and whether it does what it did."""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from labrig.cli.output import AsJson, print_json, print_line
from labrig.errors import AnswerIsNoError, RecordError


def register(app: typer.Typer) -> None:
    """Add the command to `labrig`."""
    app.command(
        "replay", help="Drive a run's procedure with its recorded camera, drives, clock and operator."
    )(replay)


def replay(
    run_path: Annotated[Path, typer.Argument(metavar="RUN", help="Folder of the run.")],
    as_json: AsJson = False,
) -> int:
    """Exit with 0 when every command and every line is the recorded one, and with 1 at the first that differs."""
    from dataclasses import asdict

    from labrig.cli.progress import progress
    from labrig.experiments import replay_run, replay_work
    from labrig.record import open_run

    run = open_run(run_path)
    if run.damage:
        first = run.damage[0]
        raise RecordError(f"{run_path} is damaged: {first.where}: {first.message}", "see: labrig runs check")
    with progress(f"replaying {run_path.name}", replay_work(run)) as reporter:
        found = replay_run(run, reporter)
    difference = found.first_difference
    document = {
        "run": str(run_path),
        "identical": found.identical,
        "first_difference": None if difference is None else asdict(difference),
        "bit_exact": found.bit_exact,
        "ended_early": found.ended_early or None,
        "compared": found.counts,
    }
    if as_json:
        print_json(document)
    else:
        _print(document)
    return 0 if found.identical else AnswerIsNoError.exit_code


def _print(document: Mapping[str, Any]) -> None:
    """Print whether all was the same, and what was compared; or the first difference with both values."""
    one = document["first_difference"]
    if one is None:
        print_line("identical, to the last bit" if document["bit_exact"] else "identical")
    else:
        place = f"after picture {_known(one['frame'])}, in trial {_known(one['trial'])}"
        print_line(f"differs at t = {one['t_s']:.3f} s, {place}")
        print_line(f"  {one['what']} in the record: {one['recorded']}")
        print_line(f"  {one['what']} in the replay: {one['now']}")
    if document["ended_early"]:
        print_line(f"  {document['ended_early']}; it is compared up to there")
    print_line("  the same: " + ", ".join(f"{count} {what}" for what, count in document["compared"].items()))


def _known(number: object) -> str:
    return "none" if number is None else str(number)
