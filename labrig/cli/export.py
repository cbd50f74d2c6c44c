"""`labrig export`: write a run as tables for other programs, or copy its record."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer

from labrig.cli.damage import note_unused, report_damage, require_undamaged
from labrig.cli.missing_package import require_package
from labrig.cli.options import RunUrlArgument
from labrig.cli.output import AsJson, print_json, print_line
from labrig.cli.progress import show_working
from labrig.errors import InputError, Problem, RecordError
from labrig.record.layout import CAMPAIGN, MANIFEST

_LATEX, _FIGURES, _FILM = "latex", "figures", "film"
_FOR_PAPER = frozenset({_LATEX, _FIGURES, _FILM})


def export(
    run: RunUrlArgument,
    out: Annotated[str, typer.Option(metavar="DIR", help="Folder to write to, or its URL.")],
    csv: Annotated[bool, typer.Option("--csv", help="A CSV file for each table.")] = False,
    parquet: Annotated[bool, typer.Option("--parquet", help="A Parquet file for each table.")] = False,
    mat: Annotated[bool, typer.Option("--mat", help="run.mat, which data/read_run.m reads.")] = False,
    mcap: Annotated[
        bool, typer.Option("--mcap", help=r"run.mcap, with the pictures; needs labrig\[mcap].")
    ] = False,
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
    ro_crate: Annotated[
        bool,
        typer.Option(
            "--ro-crate",
            help="The record, or a folder of labrig compare, as an RO-Crate, to be published; with --private its "
            "tables. Needs labrig's extra rocrate.",
        ),
    ] = False,
    license_: Annotated[
        str | None,
        typer.Option(
            "--license",
            metavar="ID",
            help="Licence of the crate: SPDX identifier, or address.",
            show_default=False,
        ),
    ] = None,
    author: Annotated[
        list[str] | None,
        typer.Option(
            "--author", metavar="NAME", help="Who made the run: 'Name' or 'Name <ORCID>'; repeatable."
        ),
    ] = None,
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
    from labrig.record.urls import output_folder, require_apart

    formats = [name for name, wanted in (("csv", csv), ("parquet", parquet), ("mat", mat)) if wanted]
    formats += [name for name, wanted in ((_LATEX, latex), (_FIGURES, figures), (_FILM, film)) if wanted]
    if license_ is not None or author or ro_crate:
        _check_crate(formats, ro_crate=ro_crate, other=mcap or record)
    else:
        _check_formats(formats, mcap=mcap, record=record, private=private)
    source = fetch_folder(run)
    if ro_crate:
        is_run = not (_is_comparison(source) or (source / CAMPAIGN).is_file())
        prepare = _prepare_crate if is_run else _prepare_folder_crate
        write, damage = prepare(source, license_, author or [], private=private)
    elif record:
        write, damage = _prepare_copy(source)
    else:
        write, damage = _prepare_tables(source, formats, mcap=mcap, private=private)
    record = record or (ro_crate and not private)
    require_apart(out, run, record=record)
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
    from labrig.record.copying import copy_record

    return partial(copy_record, source), check_run(source).damage


def _is_comparison(source: Path) -> bool:
    """Return whether a folder is one that `labrig compare` wrote."""
    return (source / "comparison.json").is_file() and not (source / MANIFEST).exists()


def _prepare_crate(
    source: Path, license_id: str | None, authors: list[str], *, private: bool
) -> tuple[Callable[[Path], None], tuple[Problem, ...]]:
    """Return what writes a crate of the record, or of its tables without personal data, and the damage of its files."""
    from labrig.record.reader import open_run
    from labrig.report.ro_crate import describe_run

    describe = _prepare_description(license_id, authors)
    content = describe_run(open_run(source))
    prepare = (
        partial(_prepare_tables, formats=["csv"], mcap=False, private=True) if private else _prepare_copy
    )
    write_files, damage = prepare(source)
    return partial(_write_crate, "tables" if private else "record", write_files, content, describe), damage


def _prepare_folder_crate(
    source: Path, license_id: str | None, authors: list[str], *, private: bool
) -> tuple[Callable[[Path], None], tuple[Problem, ...]]:
    """Return what writes a crate of a comparison or a campaign, and that nothing of it is known to be damaged."""
    from labrig.record.copying import copy_record
    from labrig.report.ro_crate import describe_campaign, describe_comparison

    what, read = (
        ("comparison", describe_comparison) if _is_comparison(source) else ("campaign", describe_campaign)
    )
    if private:
        raise InputError(
            f"--private leaves something out of the tables of a run, and this is a {what}",
            f"leave --private out; a {what} names neither computer nor account",
        )
    describe, content = _prepare_description(license_id, authors), read(source)
    return partial(_write_crate, what, partial(copy_record, source), content, describe), ()


def _prepare_description(license_id: str | None, authors: list[str]) -> Callable[[Any, Path], None]:
    """Return what describes the files in the folder of a crate. Raises `InputError`."""
    from labrig.devices.clocks import SystemClock
    from labrig.report.ro_crate import describe_crate, read_author, read_license

    if license_id is None or not authors:
        raise InputError(
            "a crate needs a licence, and who made it",
            "--license CC-BY-4.0 --author 'Name <ORCID>'",
        )
    return partial(
        describe_crate,
        license_url=read_license(license_id),
        authors=[read_author(text) for text in authors],
        published=SystemClock().utc(),
    )


def _write_crate(
    name: str,
    write_files: Callable[[Path], None],
    content: Any,
    describe: Callable[[Any, Path], None],
    folder: Path,
) -> None:
    """Write the files into a folder of the crate, and describe them."""
    inside = folder / name
    inside.mkdir()
    write_files(inside)
    describe(content, folder)


def _prepare_tables(
    source: Path, formats: list[str], *, mcap: bool, private: bool
) -> tuple[Callable[[Path], None], tuple[Problem, ...]]:
    """Return what writes the tables, and the damage of what they are made from."""
    from labrig.record.reader import open_run

    opened = open_run(source, read_pictures=True)
    note_unused(opened.problems, opened.damage)
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
        if mcap:
            from labrig.report.mcap_file import write_mcap

            write_mcap(shown, folder)

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
            write_latex(folder, run, result, summary)
        if page is not None and _FIGURES in formats:
            write_figures(folder, run, page)
        with show_working("drawing the films", shown=bool(films)):
            for film in films:
                write_film(folder, run, film)

    return write


def _check_crate(formats: list[str], *, ro_crate: bool, other: bool) -> None:
    if not ro_crate:
        raise InputError("--license and --author belong to --ro-crate", "add --ro-crate, or leave them out")
    if formats or other:
        raise InputError(
            "--ro-crate goes alone: the folder it writes is a crate", "export the rest elsewhere"
        )
    require_package("rocrate", "rocrate", "--ro-crate")


def _check_formats(formats: list[str], *, mcap: bool, record: bool, private: bool) -> None:
    if not formats and not mcap and not record:
        raise InputError(
            "nothing to write",
            "name --csv, --parquet, --mat, --mcap, --latex, --figures, --film, --record or --ro-crate",
        )
    if record and (formats or mcap):
        raise InputError("--record goes alone: the folder it writes is a run", "export the tables elsewhere")
    if record and private:
        raise InputError(
            "--record copies all of a run, and --private leaves something out",
            "export tables: --csv --private",
        )
    if mcap:
        require_package("mcap", "mcap", "--mcap")
    if "parquet" in formats:
        require_package("pyarrow", "pyarrow", "--parquet")
