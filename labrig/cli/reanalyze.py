"""`labrig reanalyze`: measures runs again and prints the new numbers beside the old ones."""

import sys
from pathlib import Path
from typing import Annotated

import typer

from labrig.cli.options import LocalRunsArgument, MaskOption
from labrig.cli.output import AsJson
from labrig.cli.several_runs import add_damage, do_for_each_run
from labrig.errors import LabrigError


def reanalyze(
    run_paths: LocalRunsArgument,
    settings: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="KEY=VALUE",
            help="Override analysis.*, or for an insertion estimator.*, planner.*, policy.*; repeatable.",
            show_default=False,
        ),
    ] = None,
    mask: MaskOption = None,
    as_json: AsJson = False,
) -> int:
    """Write RUN/analysis/NNN and print the new numbers beside the old ones; the record itself is never rewritten."""
    from labrig.cli.analyze import analyze, analyze_several
    from labrig.cli.result_comparison import (
        load_parent,
        print_comparison,
        print_old_and_new,
        report_missing_needle,
    )

    overrides, command_line = tuple(settings or ()), tuple(sys.argv)
    at_once = len(set(run_paths)) > 1
    several = analyze_several(run_paths, command_line, overrides, mask) if at_once else {}

    def reanalyze_run(path: Path) -> dict[str, object]:
        outcome = several.get(path)
        if isinstance(outcome, LabrigError):
            raise outcome
        new = analyze(path, command_line, overrides, mask) if outcome is None else outcome
        old = load_parent(path, new.content.parent)
        if not as_json:
            print_old_and_new(path, old, new)
        row: dict[str, object] = {"analysis": str(new.path), "reason": report_missing_needle(new.document)}
        return add_damage(row | print_comparison(path, old, new.document, as_json), new.document["damage"])

    return do_for_each_run(run_paths, reanalyze_run, as_json, key="analysis")
