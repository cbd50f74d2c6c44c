"""`labrig init`: makes a lab folder with examples to start from, or brings one up to date."""

import shlex
from pathlib import Path
from typing import Annotated

import typer

from labrig import __version__
from labrig.cli.output import AsJson, print_json, print_line, say, say_wrapped
from labrig.cli.schemas import FileKind, make_schema


def init(
    folder: Annotated[
        Path | None,
        typer.Argument(
            metavar="[FOLDER]", help="The folder. Default: the working folder.", show_default=False
        ),
    ] = None,
    update: Annotated[
        bool,
        typer.Option(
            "--update",
            help="Bring a lab folder up to date: add what is new, replace the schemas and the examples that nobody has "
            "changed.",
        ),
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Make a lab folder: protocols, rig files, calibration, settings for an editor. No changed file is replaced."""
    from labrig.lab.examples import read_examples
    from labrig.lab.folder import find_lab_folder
    from labrig.lab.making import list_lab_files, make_lab_folder, update_lab_folder

    files = list_lab_files({**read_examples(), **_make_schemas()})
    if update:
        place = folder or find_lab_folder() or Path()
        written = update_lab_folder(place, files, __version__)
    else:
        place = folder or Path()
        written = make_lab_folder(place, files, __version__)
    if as_json:
        print_json(
            {
                "folder": str(place),
                "labrig": __version__,
                "added": list(written.added),
                "replaced": list(written.replaced),
                "kept": list(written.kept),
            }
        )
        return
    _print(place, written.added, written.replaced, written.kept, update=update)


def _make_schemas() -> dict[str, bytes]:
    """Return the files with the schemas, by their place in a lab folder."""
    from labrig.lab.folder import CAMPAIGN_SCHEMA, PROTOCOL_SCHEMA, RIG_SCHEMA, SPECIMEN_SCHEMA
    from labrig.protocol.schema import schema_text

    kinds: dict[Path, FileKind] = {
        PROTOCOL_SCHEMA: "protocol",
        CAMPAIGN_SCHEMA: "campaign",
        RIG_SCHEMA: "rig",
        SPECIMEN_SCHEMA: "specimen",
    }
    return {place.as_posix(): schema_text(make_schema(of)).encode("utf-8") for place, of in kinds.items()}


def _print(
    folder: Path, added: tuple[str, ...], replaced: tuple[str, ...], kept: tuple[str, ...], *, update: bool
) -> None:
    """Print which files were written, which were not, and what to do next."""
    from labrig.lab.examples import find_examples

    if update:
        for place in added:
            print_line(f"added     {place}")
        for place in replaced:
            print_line(f"replaced  {place}")
        print_line(f"{folder.resolve()} is up to date with labrig {__version__}")
    else:
        print_line(f"{folder.resolve()} is a lab folder: {len(added)} files of labrig {__version__}")
    for place in kept:
        print_line(f"kept      {place}")
    if kept and update:
        example = find_examples().get(kept[0])
        beside = (
            ""
            if example is None
            else f": diff {shlex.quote(str(folder / kept[0]))} {shlex.quote(str(example))}"
        )
        say_wrapped(f"you have changed what is kept, and labrig has another version of it; compare{beside}")
    elif kept:
        say_wrapped("what is kept was there before")
    if not update:
        go = "" if folder == Path() else f"cd {shlex.quote(str(folder))}\n"
        say(f"next:\n{go}labrig check steerability\nlabrig run steerability")
