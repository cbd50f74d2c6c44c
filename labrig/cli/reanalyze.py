"""`labrig reanalyze`: measures runs again and prints the new numbers beside the old ones."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Annotated, Any

from typer import Option

from labrig.cli.agreement import print_agreement
from labrig.cli.options import RunsDirOption, RunsOrNoneArgument, WhereOption, WorkersOption
from labrig.cli.output import print_line, print_table, say
from labrig.cli.several_runs import Row, Work, add_damage, choose_runs, do_each, do_for_each_run, note_writer
from labrig.cli.signals import Interruption
from labrig.errors import LabrigError, RecordError, WorkersError


def reanalyze(
    run_paths: RunsOrNoneArgument = None,
    where: WhereOption = None,
    settings: Annotated[
        list[str] | None,
        Option(
            "--set",
            metavar="KEY=VALUE",
            help="Override analysis.*, or another key that labrig manual compare names; repeatable.",
        ),
    ] = None,
    workers: WorkersOption = None,
    runs_dir: RunsDirOption = None,
) -> int:
    """Write RUN/analysis/NNN and print the new numbers beside the old ones; the record itself is never rewritten."""
    from labrig.cli.attendant import TerminalAttendant
    from labrig.cli.progress import hold_bar
    from labrig.library import door

    runs = choose_runs(run_paths, where, runs_dir, "reanalyze")
    for run in runs:
        note_writer(run)
    overrides, attendant = tuple(settings or ()), TerminalAttendant()
    if len(runs) == 1 and workers is None:
        return do_for_each_run(
            runs,
            lambda run: _show(run, door.reanalyze(run, settings=overrides, attendant=attendant)),
            key="analysis",
        )
    measured = 0

    def list_works() -> Iterator[Work]:
        nonlocal measured
        outcomes = door.reanalyze_runs(runs, settings=overrides, workers=workers, attendant=attendant)
        with closing(outcomes):
            for run, outcome in outcomes:
                measured += 1
                with hold_bar():
                    yield run, partial(_show, run, outcome)

    try:
        return do_each(list_works(), key="analysis")
    except (Interruption, WorkersError):
        if measured:
            say(f"{measured} of {len(runs)} runs are measured; their results are kept")
        raise


def _show(path: Path, outcome: Any) -> Row:
    """Print a new result beside the one that it is compared with, and return its row. Raises an error in its place."""
    from labrig.analysis.divergence import compare_results, find_frame
    from labrig.analysis.result import list_quantities, list_values
    from labrig.experiments.registry import load_run_result
    from labrig.record.reader import open_run
    from labrig.report.formatting import label_key

    if isinstance(outcome, LabrigError):
        raise outcome
    run, new = open_run(path), outcome.document
    for number in run.result_numbers:
        if new["parent"] is None or number > new["parent"]:
            try:
                load_run_result(run, number)
            except RecordError as error:
                say(f"note: {error.message}")
    old = None if new["parent"] is None else load_run_result(run, new["parent"])
    print_line(str(path))
    for name, result in (("old", old), ("new", outcome)):
        if result is not None:
            changed = " ".join(result.content.overrides) or "the run's own settings"
            print_line(f"{name}: analysis/{result.path.name}, {changed}")
    before, now = {} if old is None else list_values(old.content), list_values(outcome.content)
    of_the_run = list_quantities(outcome.content)
    rows = [
        [label_key(name), before.get(name), value]
        for name, value in now.items()
        if name in of_the_run
        or before.get(name, value) != value
        # All that pictures which belong to no gel tell.
        or (old is None and value is not None and name.endswith(": radius_mm"))
    ]
    _print_values(rows, path.name, has_pictures=bool(new.get("measurements")))
    row: dict[str, object] = {"analysis": str(outcome.path), "reason": _find_missing_needle(new)}
    row |= {"parent": new["parent"], "verdict": None, "first_difference": None, "largest": {}}
    if old is not None:
        found = compare_results(old.document, new)
        first = found.first
        frame = None if first is None else find_frame(first.path, new) or find_frame(first.path, old.document)
        place = "of all" if frame is None else f"in frame {frame}"
        if old.content.overrides == outcome.content.overrides:
            print_agreement(found, place, ("before", "now"))
        elif first is not None:
            changed = "" if frame is None else f"; the first that changed is {place}"
            print_line(f"other settings gave other numbers{changed}")
        row |= {"verdict": str(found.verdict), "largest": found.largest}
        row["first_difference"] = None if first is None else {**asdict(first), "frame": frame}
    say(f"compare and export take the new result from now on; to write its page:\nlabrig report {path.name}")
    return add_damage(row, new["damage"])


def _print_values(rows: Sequence[Sequence[object]], run: str, *, has_pictures: bool) -> None:
    """Print old and new numbers, or in place of dashes that there are none; pictures have theirs on the page."""
    if any(value is not None for _, *values in rows for value in values):
        print_table(("", "old", "new"), rows)
    elif not has_pictures:
        print_line(f"no trial of this run has a value; what happened in it:\nlabrig runs show {run}")


def _find_missing_needle(document: Mapping[str, Any]) -> str | None:
    """Say and return that no picture shows a needle, as in an imported folder of other pictures."""
    measured = document.get("measurements", ())
    if not measured or any(measurement["found"] for measurement in measured):
        return None
    first = measured[0]["reason"]
    reason = f"shaft and tip were found in none of {len(measured)} pictures; the first: {first}"
    say(f"note: {reason}")
    return reason
