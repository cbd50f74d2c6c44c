"""`labrig run`: a protocol, on a rig where it needs one, from the file to the report."""

import math
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from labrig.cli.options import (
    DEFAULT_RUNS_DIR,
    RigOption,
    RunsDirOption,
    SeedOption,
    SetOption,
    split_overrides,
)
from labrig.cli.output import (
    AsJson,
    failure_document,
    failure_lines,
    interval,
    number,
    print_json,
    print_table,
    say,
)


def register(app: typer.Typer) -> None:
    """Add the command to `labrig`."""
    app.command(
        "run", help="Run a protocol: move, record, measure, and write the report. A design moves nothing."
    )(run)


def run(
    protocol: Annotated[Path, typer.Argument(metavar="PROTOCOL", help="Protocol file (YAML).")],
    rig: RigOption = None,
    runs_dir: RunsDirOption = DEFAULT_RUNS_DIR,
    run_name: Annotated[
        str | None,
        typer.Option(
            "--run-name",
            metavar="NAME",
            help="Folder of the run. Default: UTC time and experiment.",
            show_default=False,
        ),
    ] = None,
    seed: SeedOption = None,
    settings: SetOption = None,
    yes: Annotated[
        bool, typer.Option("--yes", help="Ask nothing on a simulated rig; never answers on a real one.")
    ] = False,
    as_json: AsJson = False,
) -> int:
    """Exit with 0 when it succeeded; the record is kept whatever happens."""
    from labrig.cli.pipeline import Order, perform
    from labrig.cli.rigs import rig_for
    from labrig.protocol import load_protocol

    protocol_settings, rig_settings = split_overrides(settings)
    loaded = load_protocol(protocol, protocol_settings, seed)
    description = rig_for(loaded, protocol, rig, rig_settings)
    if yes and description is not None and description.kind != "simulated":
        say("note: --yes does not answer on a real rig; every question is asked")
    finished = perform(Order(loaded, description, runs_dir, run_name, tuple(sys.argv)))
    document: dict[str, object] = {
        "run": str(finished.run),
        "exit_status": finished.exit_status,
        "reason": finished.reason or None,
        "report": None if finished.report is None else str(finished.report),
        "result": finished.result,
    }
    if finished.error is not None:
        document["error"] = failure_document(finished.error)
        for line in failure_lines(finished.error):
            say(line)
        if finished.needle:
            say(f"note: {finished.needle}")
        if finished.result is None:
            say(f"the record is kept: {finished.run}\nmeasure what it holds: labrig reanalyze {finished.run}")
    if as_json:
        print_json(document)
    elif finished.result is not None:
        print_result(finished.result)
        typer.echo(f"record  {finished.run}\nreport  {finished.report}")
    if finished.error is not None:
        return finished.error.exit_code
    return 1 if finished.result is not None and finished.result.get("accepted") is False else 0


def print_result(result: Mapping[str, Any]) -> None:
    """Print the table of the paper for a sweep; the verdict for a calibration; what to cut for a design."""
    if result.get("kind") == "insertion":
        _print_insertions(result)
        return
    if result.get("kind") == "roll-zero":
        _print_roll_zero(result)
        return
    if result.get("kind") == "design":
        from labrig.cli.designing import print_design

        print_design(result)
        return
    specimens: Sequence[Mapping[str, Any]] = result.get("specimens", ())
    if specimens:
        rows = [
            [
                specimen["name"],
                f"{specimen['gelatin_percent']:g}",
                specimen["n"],
                specimen["refused"],
                number(specimen["mean_radius_mm"]),
                number(specimen["sd_radius_mm"]),
                interval(specimen["ci95_mm"]),
            ]
            for specimen in specimens
        ]
        print_table(("specimen", "gelatin %", "n", "refused", "radius mm", "SD mm", "95 % interval mm"), rows)
        typer.echo(f"mean of the means  {number(result['mean_radius_mm'])} mm")
    elif "accepted" in result:
        typer.echo("calibration accepted" if result["accepted"] else "calibration refused")
        for reason in result.get("reasons", ()):
            typer.echo(f"  {reason}")


def _print_insertions(result: Mapping[str, Any]) -> None:
    rows = [
        [
            one["trial"] + 1,
            one["outcome"],
            number(one["target_error_mm"]),
            number(one["true_target_error_mm"]),
            number(one["true_min_clearance_mm"]),
            number(one["length_mm"], 1),
            one["replans"],
        ]
        for one in result["insertions"]
    ]
    heads = ("insertion", "outcome", "error mm", "true error mm", "true clearance mm", "length mm", "replans")
    print_table(heads, rows)
    typer.echo(f"{result['arrived']} of {result['made']} reached the target")


def _print_roll_zero(result: Mapping[str, Any]) -> None:
    fit = result["fit"]
    if fit is None or not result["accepted"]:
        typer.echo("roll zero refused")
        for reason in result["reasons"]:
            typer.echo(f"  {reason}")
        return
    zero, sd = (math.degrees(fit[key]) for key in ("zero_rad", "sd_rad"))
    typer.echo(
        f"needle {result['needle_id']} bends towards -y at {number(zero)} degrees, SD {number(sd)} degrees"
    )
