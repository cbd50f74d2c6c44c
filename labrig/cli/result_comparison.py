"""A new result of a run beside the result that it is compared with."""

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from labrig.analysis.divergence import Divergence, find_divergence
from labrig.analysis.result import AnyResult
from labrig.cli.output import print_line, print_table, say
from labrig.cli.several_runs import add_damage
from labrig.errors import LabrigError, RecordError
from labrig.experiments.registry import find_run_experiment, load_run_result
from labrig.record.reader import open_run


def load_parent(path: Path, number: int | None) -> AnyResult | None:
    """Return the result that a new one is compared with, or None; report newer results that are damaged."""
    run = open_run(path)
    for newer in run.result_numbers:
        if number is None or newer > number:
            try:
                load_run_result(run, newer)
            except RecordError as error:
                say(f"note: {error.message}")
    return None if number is None else load_run_result(run, number)


def print_comparison(old: AnyResult | None, new: Mapping[str, Any], as_json: bool) -> dict[str, object]:
    """Print where a result first differs from its parent, and return that for JSON."""
    if old is None:
        return {"parent": None, "first_divergence": None}
    found = find_divergence(old.document, new)
    if not as_json:
        print_line(
            "the numbers are identical" if found is None else f"first divergence: {_format_divergence(found)}"
        )
    divergence = None if found is None else asdict(found)
    return {"parent": new["parent"], "first_divergence": divergence}


def _format_divergence(found: Divergence) -> str:
    where = "" if found.frame is None else f"frame {found.frame}, "
    return f"{where}{found.key}: {found.old} before, {found.new} now"


def report_missing_needle(document: Mapping[str, Any]) -> str | None:
    """Print and return a sentence if no picture shows a needle, as in an imported folder of other pictures."""
    measured = document.get("measurements", ())
    if not measured or any(measurement["found"] for measurement in measured):
        return None
    reason = (
        f"shaft and tip were found in none of {len(measured)} pictures; the first: {measured[0]['reason']}"
    )
    say(f"note: {reason}")
    return reason


def print_old_and_new(path: Path, old: AnyResult | None, new: AnyResult) -> None:
    """Print the numbers and settings of both results, then their main values, old beside new."""
    print_line(str(path))
    for name, result in (("old", old), ("new", new)):
        if result is not None:
            settings = " ".join(result.content.overrides) or "the run's own settings"
            print_line(f"{name}: analysis/{result.path.name}, {settings}")
    experiment = find_run_experiment(open_run(path))
    before = {} if old is None else experiment.summarise(old.document).values
    now = experiment.summarise(new.document).values
    print_table(("", "old", "new"), [[name, before.get(name), value] for name, value in now.items()])


def show_result(run: Path, outcome: AnyResult | LabrigError, *, as_json: bool) -> dict[str, object]:
    """Print a new result beside the old one, and return its row. Raises the error that took its place."""
    if isinstance(outcome, LabrigError):
        raise outcome
    old = load_parent(run, outcome.content.parent)
    if not as_json:
        print_old_and_new(run, old, outcome)
    row: dict[str, object] = {
        "analysis": str(outcome.path),
        "reason": report_missing_needle(outcome.document),
    }
    return add_damage(row | print_comparison(old, outcome.document, as_json), outcome.document["damage"])
