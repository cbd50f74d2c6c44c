"""`labrig compare`: compares the measurements of runs, group by group."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

from typer import Option

from labrig.cli.options import RunsDirOption, RunsOrNoneArgument, WhereOption
from labrig.cli.output import print_json, print_line, print_table, say
from labrig.cli.progress import show_working
from labrig.cli.several_runs import choose_runs
from labrig.devices.clocks import SystemClock
from labrig.errors import RecordError
from labrig.lab import COMPARISONS, find_in_lab
from labrig.text import interval


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
            help="Group by needle, gel, specimen, hole, run, another column, or a key of the protocol; repeatable. "
            "Default: needle and gel.",
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
    with show_working("reading the runs"):
        measured, left_out = open_measured_runs(paths)
    for run in left_out:
        say(f"note: left out: {run.error.message}")
    if not measured and left_out:
        raise left_out[0].error
    with show_working("comparing"):
        compared = compare_runs(measured, left_out, quantity=quantity, by=by or ())
        differing = differences(*(one.run for one in measured)) if len(measured) == 2 else ()
        folder = _write(compared, out, differing)
    document = {
        **compared.comparison.model_dump(mode="json"),
        "differences": [asdict(found) for found in differing] if len(measured) == 2 else None,
        "report": str(folder / "report.html"),
    }
    print_json(document)
    _print(document)
    failed = [run.error.exit_code for run in left_out if where is None or isinstance(run.error, RecordError)]
    return failed[0] if failed else 0


def _write(compared: Any, out: Path | None, differing: Sequence[Any]) -> Path:
    """Write the comparison into a new folder, or into `out`, and return the folder."""
    from labrig.record.output_folder import output_folder
    from labrig.report.comparison_page import write_comparison

    now = SystemClock().utc()
    what = re.sub(r"\W+", "-", compared.comparison.quantity)[:60]
    folder = out or find_in_lab(COMPARISONS) / f"{now:%Y%m%d-%H%M%S}-{what}"
    with output_folder(folder, force=False) as made:
        write_comparison(made, compared, now, differing)
    return folder


_MOST_SHOWN = 20
_GROUP_HEADS = ("group", "n", "mean", "SD", "95 % interval", "with shared errors")
_PAIR_HEADS = ("a", "b", "a - b", "95 % interval", "p (Games-Howell)")


def _print(document: Mapping[str, Any]) -> None:
    from labrig.analysis.comparison import PROTOCOLS_DIFFER
    from labrig.report.formatting import label_quantity

    test = document["welch_anova"]
    print_line(f"{label_quantity(document['quantity'])}; n counts {document['unit_of_analysis']}s")
    groups = [
        [
            *(group[key] for key in ("name", "n", "mean", "sd")),
            interval(group["ci95"], 3),
            interval(group["ci95_with_shared"], 3),
        ]
        for group in document["groups"]
    ]
    print_table(_GROUP_HEADS, groups)
    if test is not None:
        freedom = f"{test['df_between']:g}, {test['df_within']:.2f}"
        print_line(f"Welch's ANOVA  F({freedom}) = {test['f']:.3f}, p = {test['p']:.4g}")
    pairs = [
        [
            *(pair[key] for key in ("a", "b", "difference")),
            interval(pair["ci95"], 3),
            None if pair["p"] is None else f"{pair['p']:.4g}",
        ]
        for pair in document["pairs"]
    ]
    if pairs:
        print_table(_PAIR_HEADS, pairs)
    differing = [found for found in document["differences"] or () if found["section"] != "results"]
    if differing:
        print_table(("differs in", "", "a", "b"), [list(found.values()) for found in differing[:_MOST_SHOWN]])
    if len(differing) > _MOST_SHOWN:
        print_line(f"... and in {len(differing) - _MOST_SHOWN} more values: --json lists all")
    for sentence in document["warnings"]:
        if not (differing and sentence.startswith(PROTOCOLS_DIFFER)):  # the table says it in full
            say(f"note: {sentence}")
    print_line(f"report  {document['report']}")
