"""`labrig export`: write a run as tables for other programs, draw it for a paper or a talk, or copy its record."""

from collections.abc import Callable, Collection
from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer

from labrig.cli.damage import report_damage, require_undamaged
from labrig.cli.options import RunArgument
from labrig.cli.output import AsJson, print_json, print_line
from labrig.cli.progress import show_working
from labrig.errors import InputError, Problem, RecordError
from labrig.lab import EXPORTS, find_in_lab


class Format(StrEnum):
    """What a run can be written as."""

    CSV = "csv"
    PARQUET = "parquet"
    MATLAB = "matlab"
    RECORD = "record"
    FILM = "film"


_TABLES = frozenset({Format.CSV, Format.PARQUET, Format.MATLAB})


def export(
    run: RunArgument,
    formats: Annotated[
        list[Format],
        typer.Option(
            "--format",
            help="csv, parquet: a file for each table; matlab: run.mat, which data/read_run.m reads; record: the "
            "record itself; film: each insertion as MP4. Repeatable.",
        ),
    ],
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder to write to. Default: data/exports/RUN.")
    ] = None,
    force: Annotated[
        bool, typer.Option("--force", help="Replace existing files; copy a damaged record as it is.")
    ] = False,
    as_json: AsJson = False,
) -> int:
    """Exit with 4 when the record is damaged; tables are written all the same, a copy only with --force."""
    from labrig.record.output_folder import output_folder, require_apart

    chosen, is_copy = frozenset(formats), Format.RECORD in formats
    if is_copy and len(chosen) > 1:
        raise InputError("record goes alone: the folder it writes is a run", "export the tables elsewhere")
    place = find_in_lab(EXPORTS) / run.name if out is None else out
    write, damage = _prepare_copy(run) if is_copy else _prepare(run, chosen)
    require_apart(place, run, record=is_copy)
    if is_copy and not force:
        require_undamaged(run, damage, "labrig runs check lists all; --force copies it as it is")
    with output_folder(place, force=force) as folder:
        write(folder)
        files = sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file())
    if as_json:
        print_json({"run": str(run), "out": str(place), "files": files, "ok": not damage})
    else:
        for file in [""] if is_copy else files:
            print_line(f"{place}/{file}")
    return 0 if report_damage(damage) is None else RecordError.exit_code


def _prepare_copy(source: Path) -> tuple[Callable[[Path], None], tuple[Problem, ...]]:
    """Return what copies the record, and the damage of every file to copy."""
    from labrig.record.check import check_run
    from labrig.record.output_folder import copy_record

    return partial(copy_record, source), check_run(source).damage


def _prepare(source: Path, formats: Collection[Format]) -> tuple[Callable[[Path], None], tuple[Problem, ...]]:
    """Return what writes tables and films, and the damage of what they are made from."""
    from labrig.record.reader import open_run

    opened = open_run(source)
    tables = [str(name) for name in formats if name in _TABLES]
    # Refused before anything is written.
    draw = _prepare_films(opened) if Format.FILM in formats else None

    def write(folder: Path) -> None:
        if tables:
            from labrig.report.tables import write_tables

            write_tables(opened, tables, folder)
        if draw is not None:
            draw(folder)

    return write, opened.damage


def _prepare_films(run: Any) -> Callable[[Path], None]:
    """Return what writes the films of the newest result.

    Raises
    ------
    InputError
        When the run has no insertion.
    """
    from labrig.experiments.registry import find_run_experiment, load_run_protocol, load_run_result
    from labrig.report.film import write_film

    experiment, result = find_run_experiment(run), load_run_result(run)
    films = experiment.page(run, load_run_protocol(run), result).make_films()
    if not films:
        raise InputError(
            f"{run.path} has no insertion to show as a film", "a film shows how a needle was steered"
        )

    def write(folder: Path) -> None:
        with show_working("drawing the films"):
            for film in films:
                write_film(folder, run, film)

    return write
