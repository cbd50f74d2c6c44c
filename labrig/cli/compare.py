"""`labrig compare`: compares the measurements of runs, group by group."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer

from labrig.cli.options import RunsDirOption, find_runs_dir
from labrig.cli.output import AsJson, print_json, print_line, print_table, say
from labrig.cli.progress import show_working
from labrig.cli.several_runs import find_matching_runs, require_runs_or_condition
from labrig.devices.clocks import SystemClock
from labrig.errors import RecordError
from labrig.lab import COMPARISONS, find_in_lab
from labrig.library.names import require_run_folder
from labrig.text import interval


def compare(
    run_paths: Annotated[
        list[Path] | None,
        typer.Argument(metavar="RUN...", help="Folders of runs, their names in the lab folder, or last."),
    ] = None,
    where: Annotated[
        str | None,
        typer.Option(metavar="CONDITION", help="Compare the runs that fit, as for labrig runs --where."),
    ] = None,
    quantity: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="A column of the results' tables, or TABLE.COLUMN. Default: radius_mm, else target_error_mm.",
        ),
    ] = None,
    by: Annotated[
        list[str] | None,
        typer.Option(
            "--by",
            metavar="FIELD",
            help="Group by needle, gel, specimen, hole, run, another column, or a key of the protocol; repeatable. "
            "Default: needle and gel.",
        ),
    ] = None,
    runs_dir: RunsDirOption = None,
    out: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="New folder to write to. Default: a new one in data/comparisons."),
    ] = None,
    as_json: AsJson = False,
) -> int:
    """Write a page, a tidy table and a document; exit with 4 when a run is damaged and left out."""
    from labrig.analysis.comparison import compare_runs
    from labrig.analysis.measurements import open_measured_runs

    paths = _choose_runs(run_paths or [], where, find_runs_dir(runs_dir))
    with show_working("reading the runs", shown=not as_json):
        measured, left_out = open_measured_runs(paths)
    for run in left_out:
        say(f"note: left out: {run.error.message}")
    failed = [run.error.exit_code for run in left_out if where is None or isinstance(run.error, RecordError)]
    with show_working("comparing", shown=not as_json):
        if not measured and left_out:
            raise left_out[0].error
        compared = compare_runs(measured, left_out, quantity=quantity, by=by or ())
        folder = _write(compared, out)
    document = {
        **compared.comparison.model_dump(mode="json"),
        "differences": _list_differences(measured),
        "report": str(folder / "report.html"),
    }
    if as_json:
        print_json(document)
    else:
        _print(document)
    return failed[0] if failed else 0


def _list_differences(measured: Sequence[Any]) -> list[dict[str, object]] | None:
    """Return each value in which two runs differ; None of more runs."""
    from labrig.library.door import differences

    if len(measured) != 2:
        return None
    return [asdict(difference) for difference in differences(*(one.run for one in measured))]


def _choose_runs(named: Sequence[Path], where: str | None, runs_dir: Path) -> list[Path]:
    require_runs_or_condition(named, where, "compare")
    if where is None:
        return [require_run_folder(run, runs_dir) for run in named]
    return find_matching_runs(runs_dir, where)


def _write(compared: Any, out: Path | None) -> Path:
    """Write the comparison into a new folder, or into `out`, and return the folder."""
    from labrig.record.output_folder import output_folder
    from labrig.record.writer import create_under_free_name
    from labrig.report.comparison_page import write_comparison

    now = SystemClock().utc()

    def write(folder: Path) -> Path:
        with output_folder(folder, force=False) as made:
            write_comparison(made, compared, now)
        return folder

    if out is not None:
        return write(out)
    what = re.sub(r"\W+", "-", compared.comparison.quantity)[:60]
    return create_under_free_name(now, what, lambda name: write(find_in_lab(COMPARISONS) / name))


_MOST_SHOWN = 20
_GROUP_HEADS = ("insertions", "specimens", "mean", "SD", "95 % interval", "with shared errors")
_PAIR_HEADS = ("a", "b", "a - b", "95 % interval", "p (Games-Howell)")


def _print(document: Mapping[str, Any]) -> None:
    test, counted = document["welch_anova"], f"{document['unit_of_analysis']}s"
    print_line(document["quantity"])
    print_table(
        ("group", f"n ({counted})", *_GROUP_HEADS), [_list_cells(group) for group in document["groups"]]
    )
    if test is not None:
        freedom = f"{test['df_between']:g}, {test['df_within']:.2f}"
        print_line(f"Welch's ANOVA  F({freedom}) = {test['f']:.3f}, p = {test['p']:.4g}")
    if document["pairs"]:
        print_table(_PAIR_HEADS, [_list_pair_cells(pair) for pair in document["pairs"]])
    differing = [found for found in document["differences"] or () if found["section"] != "results"]
    if differing:
        print_table(
            ("differs in", "", "a", "b"),
            [(found["section"], found["key"], found["a"], found["b"]) for found in differing[:_MOST_SHOWN]],
        )
    if len(differing) > _MOST_SHOWN:
        print_line(f"... and in {len(differing) - _MOST_SHOWN} more values: --json lists all")
    for sentence in document["warnings"]:
        say(f"note: {sentence}")
    print_line(f"report  {document['report']}")


def _list_cells(group: Mapping[str, Any]) -> tuple[object, ...]:
    return (
        *(group[key] for key in ("name", "n", "insertions", "specimens", "mean", "sd")),
        interval(group["ci95"], 3),
        interval(group["ci95_with_shared"], 3),
    )


def _list_pair_cells(pair: Mapping[str, Any]) -> tuple[object, ...]:
    return (
        *(pair[key] for key in ("a", "b", "difference")),
        interval(pair["ci95"], 3),
        None if pair["p"] is None else f"{pair['p']:.4g}",
    )
