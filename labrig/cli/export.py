"""`labrig export`: write a run as tables for other programs, as films for a talk, or copy its record."""

from collections.abc import Sequence
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

from typer import Option

from labrig.cli.options import RunArgument
from labrig.cli.output import print_json, print_line, say, say_failure
from labrig.cli.progress import progress
from labrig.cli.several_runs import note_writer, report_damage, require_undamaged
from labrig.errors import InputError, Problem, RecordError
from labrig.lab import EXPORTS, find_in_lab

Format = StrEnum("Format", ["csv", "parquet", "matlab", "record", "film"])


def export(
    run: RunArgument,
    formats: Annotated[
        list[Format],
        Option(
            "--format",
            help="csv, parquet: a file for each table; matlab: run.mat, which data/read_run.m reads; record: the "
            "record itself; film: each insertion to a target as MP4. Repeatable. Default: csv.",
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

    note_writer(run)
    is_copy, opened = "record" in formats, open_run(run)
    tables = sorted({str(name) for name in formats if name not in {"record", "film"}})
    if is_copy and len(set(formats)) > 1:
        raise InputError("record goes alone: the folder it writes is a run", "export the tables elsewhere")
    films, unfilmed = _make_films(opened, formats)
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

            for film in films:
                with progress(f"drawing {film.name}", len(film.pictures)) as report:
                    write_film(folder, opened, film, report)
        files = sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file())
    print_json({"run": str(run), "out": str(place), "files": files, "ok": not (damage or unfilmed)})
    for file in [""] if is_copy else files:
        print_line(f"{place}/{file}")
    mains = ("measurements", "insertions", "rows", "result")
    for file in [file for name in mains for file in files if Path(file).stem == name][:1]:
        print_line(f"open {file} first; columns.csv says what each column means")
    return _tell_faults(damage, unfilmed)


def _make_films(run: Any, formats: Sequence[Format]) -> tuple[Any, InputError | None]:
    """Return the films of the newest result if they are asked for, or why there is none; raise it if no table is."""
    if "film" not in formats:
        return (), None
    from labrig.experiments.registry import find_run_experiment, load_run_result

    make_films, result = find_run_experiment(run).find_part("make_films"), load_run_result(run)
    films = make_films(run, result.content) if make_films is not None and result is not None else ()
    hint = "a film shows how a needle was steered to a target, as by labrig run insertion; pictures are in frames/"
    unfilmed = None if films else InputError(f"{run.path} has no insertion to show as a film", hint)
    if unfilmed is not None and set(formats) == {"film"}:
        raise unfilmed
    return films, unfilmed


def _tell_faults(damage: Sequence[Problem], unfilmed: InputError | None) -> int:
    """Say what is damaged or missing, and return the exit code."""
    if unfilmed is not None:
        say_failure(unfilmed)
    exit_code = 0 if unfilmed is None else unfilmed.exit_code
    return exit_code if report_damage(damage) is None else RecordError.exit_code
