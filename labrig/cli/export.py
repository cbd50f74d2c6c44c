"""`labrig export`: write a run as tables for other programs, or copy its record."""

from importlib.util import find_spec
from typing import Annotated

import typer

from labrig.cli.damage import report_damage
from labrig.cli.output import AsJson, print_json, print_line
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
    private: Annotated[
        bool,
        typer.Option(
            "--private", help="Leave out host, account, command line and the authors of notes (tables)."
        ),
    ] = False,
    force: Annotated[bool, typer.Option("--force", help="Replace existing files.")] = False,
    as_json: AsJson = False,
) -> int:
    """Exit with 4 when the record is damaged; what can be read of it is written all the same."""
    from labrig.record.reader import open_run
    from labrig.record.urls import output_folder, require_apart

    formats = [name for name, wanted in (("csv", csv), ("parquet", parquet), ("mat", mat)) if wanted]
    _check_formats(formats, mcap=mcap, record=record, private=private)
    opened = open_run(run)
    require_apart(out, run, record=record)
    shown = opened.without_personal_data() if private else opened
    with output_folder(out, force=force) as folder:
        if record:
            opened.copy_to(folder)
        if formats:
            from labrig.report.export import write_tables

            write_tables(shown, formats, folder)
        if mcap:
            from labrig.report.mcap_file import write_mcap

            write_mcap(shown, folder)
        files = sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file())
    if as_json:
        print_json({"run": run, "out": out, "files": files, "ok": not opened.damage})
    else:
        for file in files if not record else [""]:
            print_line(f"{out.rstrip('/')}/{file}")
    return 0 if report_damage(opened.damage) is None else RecordError.exit_code


def _check_formats(formats: list[str], *, mcap: bool, record: bool, private: bool) -> None:
    if not formats and not mcap and not record:
        raise InputError("nothing to write", "name --csv, --parquet, --mat, --mcap or --record")
    if record and (formats or mcap):
        raise InputError("--record goes alone: the folder it writes is a run", "export the tables elsewhere")
    if record and private:
        raise InputError(
            "--record copies all of a run, and --private leaves something out",
            "export tables: --csv --private",
        )
    if mcap and find_spec("mcap") is None:
        raise InputError(
            "MCAP files need a package that is not installed",
            "in the checkout of labrig: pip install -e '.[mcap]'",
        )
