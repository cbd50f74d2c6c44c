"""`labrig export`: write a run as tables for other programs, or copy its record."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer

from labrig.cli.damage import report_damage, require_undamaged
from labrig.cli.options import RunUrlArgument
from labrig.cli.output import AsJson, print_json, print_line
from labrig.cli.progress import show_working
from labrig.errors import InputError, Problem, RecordError

_LATEX, _FIGURES, _FILM = "latex", "figures", "film"
_FOR_PAPER = frozenset({_LATEX, _FIGURES, _FILM})


def export(
    run: RunUrlArgument,
    out: Annotated[str, typer.Option(metavar="DIR", help="Folder to write to, or its URL.")],
    csv: Annotated[bool, typer.Option("--csv", help="A CSV file for each table.")] = False,
    parquet: Annotated[bool, typer.Option("--parquet", help="A Parquet file for each table.")] = False,
    mat: Annotated[bool, typer.Option("--mat", help="run.mat, which data/read_run.m reads.")] = False,
    latex: Annotated[
        bool,
        typer.Option(
            "--latex", help="Tables of the newest result, and a paragraph on methods with all settings."
        ),
    ] = False,
    figures: Annotated[
        bool, typer.Option("--figures", help="The figures of the newest result's page, as SVG and PDF.")
    ] = False,
    film: Annotated[
        bool,
        typer.Option(
            "--film", help="A film of each insertion, with plan, estimate and target drawn in (MP4)."
        ),
    ] = False,
    record: Annotated[bool, typer.Option("--record", help="The record itself, file by file.")] = False,
    private: Annotated[
        bool,
        typer.Option(
            "--private", help="Leave out host, account, command line and the authors of notes (tables)."
        ),
    ] = False,
    force: Annotated[
        bool, typer.Option("--force", help="Replace existing files; copy a damaged record as it is.")
    ] = False,
    as_json: AsJson = False,
) -> int:
    """Exit with 4 when the record is damaged; tables are written all the same, a copy only with --force."""
    from labrig.record.reader import fetch_folder
    from labrig.record.remote import output_folder, require_apart

    formats = [name for name, wanted in (("csv", csv), ("parquet", parquet), ("mat", mat)) if wanted]
    formats += [name for name, wanted in ((_LATEX, latex), (_FIGURES, figures), (_FILM, film)) if wanted]
    _check_formats(formats, record=record, private=private)
    source = fetch_folder(run)
    write, damage = _prepare_copy(source) if record else _prepare_tables(source, formats, private=private)
    require_apart(out, source, record=record)
    if record and not force:
        require_undamaged(run, damage, "labrig runs check lists all; --force copies it as it is")
    with output_folder(out, force=force) as folder:
        write(folder)
        files = sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file())
    if as_json:
        print_json({"run": run, "out": out, "files": files, "ok": not damage})
    else:
        for file in files if not record else [""]:
            print_line(f"{out.rstrip('/')}/{file}")
    return 0 if report_damage(damage) is None else RecordError.exit_code


def _prepare_copy(source: Path) -> tuple[Callable[[Path], None], tuple[Problem, ...]]:
    """Return what copies the record, and the damage of every file to copy."""
    from labrig.record.check import check_run
    from labrig.record.remote import copy_record

    return partial(copy_record, source), check_run(source).damage


def _prepare_tables(
    source: Path, formats: list[str], *, private: bool
) -> tuple[Callable[[Path], None], tuple[Problem, ...]]:
    """Return what writes the tables, and the damage of what they are made from."""
    from labrig.record.reader import open_run

    opened = open_run(source)
    shown = opened.without_personal_data() if private else opened
    tables = [name for name in formats if name not in _FOR_PAPER]
    # Drawn and refused before anything is written.
    write_for_paper = _prepare_for_paper(shown, formats) if len(tables) < len(formats) else None

    def write(folder: Path) -> None:
        if tables:
            from labrig.report.export import write_tables

            write_tables(shown, tables, folder)
        if write_for_paper is not None:
            write_for_paper(folder)

    return write, opened.damage


def _prepare_for_paper(run: Any, formats: list[str]) -> Callable[[Path], None]:
    """Return what writes LaTeX, figures and films of the newest result.

    Raises
    ------
    InputError
        When films are asked for, and the run has no insertion.
    """
    from labrig.experiments.registry import find_run_experiment, load_run_protocol, load_run_result
    from labrig.report.figure_files import write_figures
    from labrig.report.film import write_film
    from labrig.report.latex import write_latex

    experiment, result = find_run_experiment(run), load_run_result(run)
    if result is not None and run.private:
        result = result.without_personal_data()
    drawn = {_FIGURES, _FILM} & set(formats)
    page = experiment.page(run, load_run_protocol(run), result) if drawn else None
    films = page.make_films() if page is not None and _FILM in formats else ()
    if _FILM in formats and not films:
        raise InputError(
            f"{run.path} has no insertion to show as a film", "a film shows how a needle was steered"
        )

    def write(folder: Path) -> None:
        if _LATEX in formats:
            summary = None if result is None else experiment.summarise(result.document)
            write_latex(folder, summary)
        if page is not None and _FIGURES in formats:
            write_figures(folder, run, page)
        with show_working("drawing the films", shown=bool(films)):
            for film in films:
                write_film(folder, run, film)

    return write


def _check_formats(formats: list[str], *, record: bool, private: bool) -> None:
    if not formats and not record:
        raise InputError(
            "nothing to write",
            "name --csv, --parquet, --mat, --latex, --figures, --film or --record",
        )
    if record and formats:
        raise InputError("--record goes alone: the folder it writes is a run", "export the tables elsewhere")
    if record and private:
        raise InputError(
            "--record copies all of a run, and --private leaves something out",
            "export tables: --csv --private",
        )
