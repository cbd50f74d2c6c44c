"""`labrig init`: makes a lab folder with examples to start from."""

import shlex
from pathlib import Path
from typing import Annotated

from typer import Argument

from labrig.cli.output import print_json, print_line, say


def init(
    folder: Annotated[
        Path, Argument(metavar="[FOLDER]", help="The folder. Default: the working folder.")
    ] = Path(),
) -> None:
    """In a lab folder that exists, add the examples that it lacks, and write the schemas anew; keep all other files."""
    say(f"making a lab folder of {folder.resolve()}")  # before the imports, which take a second
    from labrig.lab import make_lab_folder, read_examples

    written, kept = make_lab_folder(folder, {**read_examples(), **make_schemas()})
    print_json({"folder": str(folder), "written": written, "kept": kept})
    print_line(f"{folder.resolve()} is a lab folder: {len(written)} files written")
    if kept:
        say(f"kept as they are, and other than labrig's: {', '.join(kept)}")
    go = "" if folder == Path() else f"cd {shlex.quote(str(folder))}\n"
    say(f"next:\n{go}labrig check steerability\nlabrig run steerability --set insertions_per_specimen=3")


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
