"""`labrig init`: makes a lab folder with examples to start from."""

import shlex
from pathlib import Path
from typing import Annotated, Any

import typer

from labrig.cli.output import AsJson, print_line, say, show


def init(
    folder: Annotated[
        Path, typer.Argument(metavar="[FOLDER]", help="The folder. Default: the working folder.")
    ] = Path(),
    as_json: AsJson = False,
) -> None:
    """In a lab folder that exists, add the examples that it lacks, and write the schemas anew; keep all other files."""
    from labrig.lab import make_lab_folder, read_examples

    written, kept = make_lab_folder(folder, {**read_examples(), **make_schemas()})
    show({"folder": str(folder), "written": written, "kept": kept}, as_json, _print)


def make_schemas() -> dict[str, bytes]:
    """Return the JSON Schemas by their place in a lab folder, with what installed packages add to them."""
    from labrig.campaign.campaign_file import campaign_schema
    from labrig.devices.rig_file import rig_schema
    from labrig.experiments.declared import list_usable_models
    from labrig.lab import CAMPAIGN_SCHEMA, PROTOCOL_SCHEMA, RIG_SCHEMA, SPECIMEN_SCHEMA
    from labrig.protocol.load import protocol_schema
    from labrig.protocol.schema import schema_text
    from labrig.protocol.specimen_file import specimen_schema

    schemas = {
        PROTOCOL_SCHEMA: protocol_schema(list_usable_models()),
        CAMPAIGN_SCHEMA: campaign_schema(),
        RIG_SCHEMA: rig_schema(),
        SPECIMEN_SCHEMA: specimen_schema(),
    }
    return {place.as_posix(): schema_text(schema).encode("utf-8") for place, schema in schemas.items()}


def _print(done: dict[str, Any]) -> None:
    folder = Path(done["folder"])
    print_line(f"{folder.resolve()} is a lab folder: {len(done['written'])} files written")
    if done["kept"]:
        say(f"kept as they are, and other than labrig's: {', '.join(done['kept'])}")
    go = "" if folder == Path() else f"cd {shlex.quote(str(folder))}\n"
    say(f"next:\n{go}labrig check steerability\nlabrig run steerability")
