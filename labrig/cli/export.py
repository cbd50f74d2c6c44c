"""`labrig export`: write a run as tables for other programs, or copy its record."""

from pathlib import Path
from typing import Annotated

import typer

from labrig.cli.damage import report_damage
from labrig.cli.output import AsJson, print_json, print_line
from labrig.durable import write_atomically
from labrig.errors import InputError, RecordError


def export(
    run: Annotated[str, typer.Argument(metavar="RUN", help="Folder of a run, or its URL (fsspec).")],
    out: Annotated[str, typer.Option(metavar="DIR", help="Folder to write to, or its URL.")],
    csv: Annotated[bool, typer.Option("--csv", help="A CSV file for each table.")] = False,
    parquet: Annotated[bool, typer.Option("--parquet", help="A Parquet file for each table.")] = False,
    mat: Annotated[bool, typer.Option("--mat", help="run.mat, which data/read_run.m reads.")] = False,
    mcap: Annotated[
        bool, typer.Option("--mcap", help="run.mcap, with the pictures; needs labrig's extra mcap.")
    ] = False,
    record: Annotated[bool, typer.Option("--record", help="The record itself, file by file.")] = False,
    force: Annotated[bool, typer.Option("--force", help="Replace existing files.")] = False,
    as_json: AsJson = False,
) -> int:
    """Exit with 4 when the record is damaged; what can be read of it is written all the same."""
    from labrig.record.reader import open_run
    from labrig.record.urls import output_folder, require_apart

    formats = [name for name, wanted in (("csv", csv), ("parquet", parquet), ("mat", mat)) if wanted]
    if not formats and not mcap and not record:
        raise InputError("nothing to write", "name --csv, --parquet, --mat, --mcap or --record")
    if record and (formats or mcap):
        raise InputError("--record goes alone: the folder it writes is a run", "export the tables elsewhere")
    opened = open_run(run)
    require_apart(out, run, record=record)
    with output_folder(out, force=force) as folder:
        if record:
            opened.copy_to(folder)
        if formats:
            _write_tables(opened.path, formats, folder)
        if mcap:
            _write_mcap(opened.path, folder)
        files = sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file())
    if as_json:
        print_json({"run": run, "out": out, "files": files, "ok": not opened.damage})
    else:
        for file in files if not record else [""]:
            print_line(f"{out.rstrip('/')}/{file}")
    return 0 if report_damage(opened.damage) is None else RecordError.exit_code


def _write_tables(run: Path, formats: list[str], folder: Path) -> None:
    from labrig.record.reader import open_run
    from labrig.report.export import FORMATS
    from labrig.report.tables import run_tables

    opened = open_run(run)
    tables = run_tables(opened, opened.latest_result())
    for name in formats:
        for file, content in FORMATS[name](opened, tables).items():
            write_atomically(folder / file, content)


def _write_mcap(run: Path, folder: Path) -> None:
    from labrig.record.reader import open_run

    try:
        from labrig.report.mcap_file import write_mcap
    except ModuleNotFoundError as error:
        raise InputError(
            "MCAP files need a package that is not installed", "pip install 'labrig[mcap]'"
        ) from error
    write_mcap(open_run(run), folder)
