"""`labrig compare`: compares the measurements of runs, group by group."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

from typer import Option

from labrig.cli.options import RunsDirOption, RunsOrNoneArgument, WhereOption
from labrig.cli.output import print_json, print_line, print_table, quote, say
from labrig.cli.progress import show_working
from labrig.cli.several_runs import choose_runs, note_writer
from labrig.devices.clocks import SystemClock
from labrig.errors import RecordError
from labrig.lab import COMPARISONS, find_in_lab
from labrig.text import interval, number


def compare(
    run_paths: RunsOrNoneArgument = None,
    where: WhereOption = None,
    quantity: Annotated[
        str | None,
        Option(metavar="COLUMN", help="Or TABLE.COLUMN. Default: radius_mm, else target_error_mm."),
    ] = None,
    by: Annotated[
        list[str] | None,
        Option(
            metavar="FIELD",
            help="Group by needle, gel, specimen, hole, run, another column, or a key or section of the protocol; "
            "repeatable. Default: needle and gel; where these are the same, the policy if each run has its own, or "
            "the run.",
        ),
    ] = None,
    runs_dir: RunsDirOption = None,
    out: Annotated[
        Path | None, Option(metavar="DIR", help="New folder. Default: one in data/comparisons.")
    ] = None,
) -> int:
    """Write a page, a tidy table and a document; exit with 4 when a run is damaged and left out."""
    from labrig.analysis.comparison import compare_runs
    from labrig.analysis.measurements import open_measured_runs
    from labrig.library.door import differences

    paths = choose_runs(run_paths, where, runs_dir, "compare")
    for path in paths:
        note_writer(path)
    with show_working("reading the runs"):
        measured, left_out = open_measured_runs(paths)
    for run in left_out:
        say(f"note: left out: {run.error.message}")
    if not measured and left_out:
        raise left_out[0].error
    with show_working("comparing"):
        compared = compare_runs(measured, left_out, quantity=quantity, by=by or ())
        differing = differences(*(one.run for one in measured)) if len(measured) == 2 else ()
        folder, shown = _write(compared, out, measured)
    document = {
        **compared.comparison.model_dump(mode="json"),
        "differences": [asdict(found) for found in differing] if len(measured) == 2 else None,
        "report": str(folder / "report.html"),
    }
    print_json(document)
    _print(document | shown.model_dump(mode="json"))
    failed = [run.error.exit_code for run in left_out if where is None or isinstance(run.error, RecordError)]
    return failed[0] if failed else 0


def _write(compared: Any, out: Path | None, measured: Sequence[Any]) -> tuple[Path, Any]:
    """Write the comparison into a new folder, or into `out`; return the folder, and what its page shows."""
    from labrig.record.output_folder import output_folder
    from labrig.report.comparison_page import write_comparison

    now = SystemClock().utc()
    what = re.sub(r"\W+", "-", compared.comparison.quantity)[:60]
    folder = out or find_in_lab(COMPARISONS) / f"{now:%Y%m%d-%H%M%S}-{what}"
    with output_folder(folder) as made:
        return folder, write_comparison(made, compared, now, measured)


def _print(document: Mapping[str, Any]) -> None:
    from labrig.report.formatting import count_decimals

    quote(document["report"])
    unit, found = f" {document['unit'] or ''}".rstrip(), document["groups"]
    digits = count_decimals([of["ci95"] for of in found], [of["mean"] for of in found])
    groups = [[of["name"], of["n"], *_tell(of, ("mean", "sd"), digits)] for of in found]
    if any(group["n"] > 1 for group in found):
        print_table(("group", "n", f"mean{unit}", f"SD{unit}", f"95 % interval{unit}"), groups)
    pairs = [
        [f"{of['a']} - {of['b']}", *_tell(of, ("difference",), digits), of["p"] and f"{of['p']:.4g}"]
        for of in document["pairs"]
    ]
    if len(pairs) > 1:  # the headline tells a single one
        ci95 = f"95 % interval{unit}, all {len(pairs)} pairs together"
        print_table(("pair", f"difference{unit}", ci95, "p"), pairs)
    for sentence in document["warnings"]:
        say(f"note: {sentence}")
    print_line(f"report  {document['report']}")


def _tell(row: Mapping[str, Any], keys: Sequence[str], digits: int) -> list[str]:
    """Return values, and the interval that holds the errors that all measurements share, too, if they are known."""
    ends = interval(row["ci95_with_shared"] or row["ci95"], digits)
    return [*(number(row[key], digits) for key in keys), ends]
