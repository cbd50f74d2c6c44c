"""`labrig reanalyze`: a run measured again, and the new numbers beside the old ones."""

import sys
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer

from labrig.cli.options import LocalRunsArgument, MaskOption
from labrig.cli.output import AsJson, print_line, print_table, say
from labrig.cli.several_runs import add_damage, do_for_each_run
from labrig.errors import LabrigError, RecordError


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

    overrides, command_line = tuple(settings or ()), tuple(sys.argv)
    at_once = len(set(run_paths)) > 1
    several = analyze_several(run_paths, command_line, overrides, mask) if at_once else {}

    def one(path: Path) -> dict[str, object]:
        outcome = several.get(path)
        if isinstance(outcome, LabrigError):
            raise outcome
        new = analyze(path, command_line, overrides, mask) if outcome is None else outcome
        old = _parent(path, new.content.parent)
        if not as_json:
            _print_old_and_new(path, old, new)
        row: dict[str, object] = {"analysis": str(new.path), "reason": _nothing_found(new.document)}
        return add_damage(row | _compared(path, old, new.document, as_json), new.document["damage"])

    return do_for_each_run(run_paths, one, as_json, key="analysis")


def _parent(path: Path, number: int | None) -> Any:
    """Return the result that a new one is compared with, None where there is none; name newer ones that are damaged."""
    from labrig.analysis.result import list_result_numbers
    from labrig.experiments.registry import result_of
    from labrig.record.reader import open_run

    run = open_run(path)
    for newer in list_result_numbers(run):
        if number is None or newer > number:
            try:
                result_of(run, newer)
            except RecordError as error:
                say(f"note: {error.message}")
    return None if number is None else result_of(run, number)


def _compared(path: Path, old: Any, new: Mapping[str, Any], as_json: bool) -> dict[str, object]:
    """Say where a result parts from its parent, and return that for JSON."""
    from labrig.analysis.divergence import find_divergence
    from labrig.experiments.registry import experiment_of
    from labrig.record.reader import open_run

    if old is None:
        return {"parent": None, "first_divergence": None}
    found = find_divergence(old.document, new)
    comparison = experiment_of(open_run(path)).compare(old.document, new)
    if not as_json:
        print_line("the numbers are identical" if found is None else f"first divergence: {_told(found)}")
        for line in comparison.lines:
            print_line(line)
    divergence = None if found is None else asdict(found)
    return {"parent": new["parent"], "first_divergence": divergence, **comparison.document}


def _told(found: Any) -> str:
    where = "" if found.frame is None else f"frame {found.frame}, "
    return f"{where}{found.key}: {found.old} before, {found.new} now"


def _nothing_found(document: Mapping[str, Any]) -> str | None:
    """Return a sentence where no picture shows a needle, as when a folder of other pictures was imported."""
    measured = document.get("measurements", ())
    if not measured or any(one["found"] for one in measured):
        return None
    reason = (
        f"shaft and tip were found in none of {len(measured)} pictures; the first: {measured[0]['reason']}"
    )
    say(f"note: {reason}")
    return reason


def _print_old_and_new(path: Path, old: Any, new: Any) -> None:
    """Print what counts in the results of an experiment, old beside new, under their numbers and settings."""
    from labrig.experiments.registry import experiment_of
    from labrig.record.reader import open_run

    print_line(str(path))
    for name, result in (("old", old), ("new", new)):
        if result is not None:
            settings = " ".join(result.content.overrides) or "the run's own settings"
            print_line(f"{name}: analysis/{result.path.name}, {settings}")
    experiment = experiment_of(open_run(path))
    before = {} if old is None else experiment.summarise(old.document).values
    now = experiment.summarise(new.document).values
    print_table(("", "old", "new"), [[name, before.get(name), value] for name, value in now.items()])
