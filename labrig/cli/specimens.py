"""`labrig specimens`: the blocks of gel that protocols name, their files, tracks and labels."""

import re
from dataclasses import asdict
from datetime import datetime
from pathlib import Path
from typing import Annotated

import typer

from labrig.cli.options import RunsDirOption, find_runs_dir
from labrig.cli.output import AsJson, print_json, print_line, print_table, say, say_wrapped
from labrig.devices.clocks import SystemClock
from labrig.durable import disk_errors, write_atomically
from labrig.errors import FileFormatError, InputError, OutputExistsError, Problem
from labrig.lab.folder import SPECIMENS, find_in_lab
from labrig.protocol.specimen_file import (
    SUFFIX,
    SpecimenFile,
    list_specimens,
    load_specimen,
)
from labrig.protocol.yaml_file import dump_yaml, validate_values

app = typer.Typer(no_args_is_help=True)

_SCHEMA_FILE = "specimen.schema.json"
_COMMAND = "labrig specimens new"
_KEYS = re.compile(
    r"\b(?:gelatin_percent|batch|mixed_on|cast_on|cured_for_h|cured_at_celsius|usable_until)\b(?= is|, )"
)
_HEAD = f"# yaml-language-server: $schema={_SCHEMA_FILE}\n"


def _complete_name(incomplete: str) -> list[str]:
    return [name for name in list_specimens() if name.startswith(incomplete)]


NameArgument = Annotated[
    str, typer.Argument(metavar="NAME", help="Name of the specimen.", autocompletion=_complete_name)
]


@app.command("new", help="Write the file of a new specimen, in data/specimens.")
def new(
    name: Annotated[str, typer.Argument(metavar="NAME", help="Label on the block.")],
    gelatin_percent: Annotated[
        float, typer.Option(help="Mass of gelatin powder per mass of water; 10 for 10 %.")
    ],
    cast_on: Annotated[
        str | None,
        typer.Option(
            metavar="TIME",
            help="When it was cast, such as 2026-11-20T09:30; without a distance from UTC, this computer's. "
            "Default: now.",
            show_default=False,
        ),
    ] = None,
    mixed_on: Annotated[
        str | None, typer.Option(metavar="TIME", help="When powder and water were mixed.", show_default=False)
    ] = None,
    usable_until: Annotated[
        str | None, typer.Option(metavar="TIME", help="A run after that is refused.", show_default=False)
    ] = None,
    batch: Annotated[str, typer.Option(metavar="TEXT", help="Batch of gelatin.", show_default=False)] = "",
    cured_for_h: Annotated[
        float | None, typer.Option(help="How long it cures before it is used.", show_default=False)
    ] = None,
    cured_at_celsius: Annotated[
        float | None, typer.Option(help="Temperature at which it cures.", show_default=False)
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Write the file; what else is known of the block is entered in it. An existing file is never replaced."""
    values: dict[str, object] = {
        "name": name,
        "gelatin_percent": gelatin_percent,
        "batch": batch,
        "mixed_on": _add_zone(mixed_on),
        "cast_on": _add_zone(cast_on) or SystemClock().utc().astimezone().isoformat(timespec="minutes"),
        "cured_for_h": cured_for_h,
        "cured_at_celsius": cured_at_celsius,
        "usable_until": _add_zone(usable_until),
    }
    try:
        specimen = validate_values(values, _COMMAND, SpecimenFile)
    except FileFormatError as error:
        raise FileFormatError(tuple(map(_name_options, error.problems))) from error
    path = find_in_lab(SPECIMENS) / f"{name}{SUFFIX}"
    _require_new(path, "", "edit it, or give the new block another name: its tracks are kept under it")
    with disk_errors(path):
        path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, (_HEAD + dump_yaml(specimen)).encode("utf-8"))
    if as_json:
        print_json({"file": str(path), **specimen.model_dump(mode="json")})
        return
    print_line(str(path))
    say(f"in a protocol: specimen_file: {name}; its label: labrig specimens label {name} --to {name}.svg")


def _name_options(problem: Problem) -> Problem:
    """Return a problem that names options instead of the keys of the file."""
    message, hint = (_KEYS.sub(_name_option, text) for text in (problem.message, problem.hint))
    return Problem(_COMMAND, message, hint)


def _name_option(key: re.Match[str]) -> str:
    return f"--{key[0].replace('_', '-')}"


def _require_new(path: Path, option: str, hint: str) -> None:
    """Refuse to replace a file. Raises `OutputExistsError`."""
    if path.exists():
        raise OutputExistsError(f"{option}{path} exists already", hint)


def _add_zone(text: str | None) -> str | None:
    """Return a time with this computer's distance from UTC if it has none; other text as it is."""
    if text is None:
        return None
    try:
        moment = datetime.fromisoformat(text)
    except ValueError:
        return text
    return moment.astimezone().isoformat(timespec="minutes") if moment.tzinfo is None else text


@app.command("list", help="List the specimens.")
def list_(as_json: AsJson = False) -> None:
    """List the specimens of data/specimens; a file that cannot be read is named."""
    rows, faults = [], []
    for name in list_specimens():
        try:
            rows.append(load_specimen(name)[0])
        except InputError as error:
            faults.append(error)
    if as_json:
        print_json([specimen.model_dump(mode="json") for specimen in rows])
    elif rows:
        heads = ["specimen", "gelatin %", "batch", "cast", "usable until"]
        cells = [
            [row.name, f"{row.gelatin_percent:g}", row.batch, row.cast_on, row.usable_until] for row in rows
        ]
        print_table(heads, cells)
    else:
        say(
            f"no specimens in {find_in_lab(SPECIMENS)}; "
            "write the first with: labrig specimens new NAME --gelatin-percent 10"
        )
    for fault in faults:
        say_wrapped(f"note: {fault.message}")


@app.command("show", help="Show what is known of a specimen, and every track in it.")
def show(name: NameArgument, runs_dir: RunsDirOption = None, as_json: AsJson = False) -> None:
    """Show its file, and the tracks that the runs of a folder have left in it: of real runs, and of simulated ones."""
    from labrig.experiments.specimen_tracks import find_tracks

    specimen, sha256 = load_specimen(name)
    folder = find_runs_dir(runs_dir)
    found = {
        kind: find_tracks(folder, [name], simulated=kind == "simulated") for kind in ("real", "simulated")
    }
    tracks = {kind: held.tracks[name] for kind, held in found.items()}
    unread = {problem.where: problem for held in found.values() for problem in held.unread}.values()
    if as_json:
        listed = {kind: [track.model_dump(mode="json") for track in held] for kind, held in tracks.items()}
        document = {**specimen.model_dump(mode="json"), "sha256": sha256, "tracks": listed}
        print_json({**document, "unread": [asdict(problem) for problem in unread]})
        return
    print_line(dump_yaml(specimen).rstrip())
    heads = ["track", "run", "hole", "place mm", "needle", "age h", "radius mm"]
    for kind, held in tracks.items():
        if held:
            print_line(f"\ntracks of {kind} runs:")
            print_table(
                heads,
                [
                    [
                        number,
                        track.run,
                        track.hole + 1,
                        f"{track.hole_position_mm:g}",
                        track.needle_id,
                        f"{track.age_h:.1f}",
                        "-" if track.radius_mm is None else f"{track.radius_mm:.2f}",
                    ]
                    for number, track in enumerate(held, start=1)
                ],
            )
    if not (any(tracks.values()) or unread):
        say(f"no run in {folder} has inserted into it")
    for problem in unread:
        say_wrapped(f"note: {problem.where}: its tracks are not known: {problem.message}")


@app.command("label", help="Draw the label of a specimen as SVG, with a QR code.")
def label(
    name: NameArgument,
    to: Annotated[Path, typer.Option("--to", metavar="FILE", help="The SVG file; not an existing one.")],
) -> None:
    """Draw the label: 62 x 29 mm, the name as a QR code and what a person reads beside it."""
    from labrig.report.specimen_label import draw_label

    specimen, _ = load_specimen(name)
    if to.suffix.lower() != ".svg":
        raise InputError(f"--to {to} is not an SVG file", f"name it {to.stem or name}.svg")
    _require_new(to, "--to ", "name another file")
    write_atomically(to, draw_label(specimen))
    print_line(str(to))
