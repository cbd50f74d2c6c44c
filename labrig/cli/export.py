"""`labrig export`: write a run as tables for other programs, as films for a talk, or copy its record."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

from typer import Option

from labrig.cli.options import RunArgument
from labrig.cli.output import print_json, print_line, say
from labrig.cli.progress import show_working
from labrig.cli.several_runs import report_damage, require_undamaged
from labrig.errors import InputError, RecordError
from labrig.lab import EXPORTS, find_in_lab

Format = StrEnum("Format", ["csv", "parquet", "matlab", "record", "film"])


def export(
    run: RunArgument,
    formats: Annotated[
        list[Format],
        Option(
            "--format",
            help="csv, parquet: a file for each table; matlab: run.mat, which data/read_run.m reads; record: the "
            "record itself; film: each insertion as MP4. Repeatable. Default: csv.",
        ),
    ] = (Format.csv,),  # type: ignore[assignment]
    out: Annotated[
        Path | None, Option(metavar="DIR", help="Folder to write to. Default: data/exports/RUN.")
    ] = None,
    force: Annotated[
        bool, Option("--force", help="Replace existing files; copy a damaged record as it is.")
    ] = False,
) -> int:
    """Exit with 4 when the record is damaged; tables are written all the same, a copy only with --force."""
    from labrig.record.check import check_run
    from labrig.record.output_folder import copy_record, output_folder, require_apart
    from labrig.record.reader import open_run

    is_copy, opened = "record" in formats, open_run(run)
    tables = sorted({str(name) for name in formats if name not in {"record", "film"}})
    if is_copy and len(set(formats)) > 1:
        raise InputError("record goes alone: the folder it writes is a run", "export the tables elsewhere")
    films = _make_films(opened) if "film" in formats else ()
    damage = check_run(run).damage if is_copy else opened.damage
    place = find_in_lab(EXPORTS) / run.name if out is None else out
    require_apart(place, run, record=is_copy)
    if is_copy and not force:
        require_undamaged(run, damage, "labrig runs check lists all; --force copies it as it is")
    with output_folder(place, force=force) as folder:
        if is_copy:
            copy_record(run, folder)
        if tables:
            from labrig.analysis.result import note_overrides
            from labrig.report.tables import write_tables

            write_tables(opened, tables, folder)
            overrides = (opened.result or {}).get("overrides", ())
            for sentence in note_overrides(run.name, max(opened.result_numbers, default=0), overrides):
                say(f"note: {sentence}")
        if films:
            from labrig.report.film import write_film

            with show_working("drawing the films"):
                for film in films:
                    write_film(folder, opened, film)
        files = sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file())
    print_json({"run": str(run), "out": str(place), "files": files, "ok": not damage})
    for file in [""] if is_copy else files:
        print_line(f"{place}/{file}")
    mains = ("measurements", "insertions", "rows", "result")
    for file in [file for name in mains for file in files if Path(file).stem == name][:1]:
        print_line(f"open {file} first; columns.csv says what each column means")
    return 0 if report_damage(damage) is None else RecordError.exit_code


def _make_films(run: Any) -> Any:
    """Return the films of the newest result. Raises `InputError` when the run has no insertion."""
    from labrig.experiments.registry import find_run_experiment, load_run_result

    make_films, result = find_run_experiment(run).find_part("make_films"), load_run_result(run)
    films = make_films(run, result.content) if make_films is not None and result is not None else ()
    if not films:
        raise InputError(
            f"{run.path} has no insertion to show as a film", "a film shows how a needle was steered"
        )
    return films
