"""`labrig specimens`: the blocks of gel that protocols name, their files and tracks."""

from dataclasses import asdict
from typing import Annotated, Any

import typer

from labrig.cli.options import find_runs_dir
from labrig.cli.output import AsJson, print_line, print_table, say, show


def _complete_name(incomplete: str) -> list[str]:
    from labrig.protocol.specimen_file import list_specimens

    return [name for name in list_specimens() if name.startswith(incomplete)]


def specimens(
    name: Annotated[
        str | None, typer.Argument(metavar="[NAME]", help="Show this one.", autocompletion=_complete_name)
    ] = None,
    as_json: AsJson = False,
) -> None:
    """List the specimens of data/specimens; of one, its file and the tracks that real and simulated runs left in it."""
    if name is None:
        show(_list(), as_json, _print_list)
        return
    from labrig.experiments.specimen_tracks import find_tracks
    from labrig.protocol.specimen_file import load_specimen

    specimen, sha256 = load_specimen(name)
    folder = find_runs_dir()
    found = {
        kind: find_tracks(folder, [name], simulated=kind == "simulated") for kind in ("real", "simulated")
    }
    tracks = {
        kind: [track.model_dump(mode="json") for track in held.tracks[name]] for kind, held in found.items()
    }
    unread = {problem.where: asdict(problem) for held in found.values() for problem in held.unread}
    document = {**specimen.model_dump(mode="json"), "sha256": sha256, "tracks": tracks}
    show({**document, "unread": list(unread.values())}, as_json, _print_specimen)
    if not (as_json or any(tracks.values()) or unread):
        say(f"no run in {folder} has inserted into it")


def _list() -> list[dict[str, Any]]:
    """Return what the files of the specimens say; a file that cannot be read is named."""
    from labrig.errors import InputError
    from labrig.protocol.specimen_file import list_specimens, load_specimen

    rows = []
    for name in list_specimens():
        try:
            rows.append(load_specimen(name)[0].model_dump(mode="json"))
        except InputError as error:
            say(f"note: {error.message}")
    return rows


def _print_list(rows: list[dict[str, Any]]) -> None:
    if not rows:
        say("no specimens in data/specimens; labrig manual protocol says how to write the first")
        return
    keys = ("name", "gelatin_percent", "batch", "cast_on", "usable_until")
    heads = ("specimen", "gelatin %", "batch", "cast", "usable until")
    print_table(heads, [[row[key] for key in keys] for row in rows])


def _print_specimen(document: dict[str, Any]) -> None:
    for key, value in document.items():
        if key not in {"tracks", "unread", "sha256"} and value is not None:
            print_line(f"{key}: {value}")
    heads = ("track", "run", "hole", "place mm", "needle", "age h")
    for kind, tracks in document["tracks"].items():
        if tracks:
            print_line(f"\ntracks of {kind} runs:")
            print_table(heads, [_list_cells(number, track) for number, track in enumerate(tracks, start=1)])
    for problem in document["unread"]:
        say(f"note: {problem['where']}: its tracks are not known: {problem['message']}")


def _list_cells(number: int, track: dict[str, Any]) -> list[object]:
    place, age = track["hole_position_mm"], track["age_h"]
    return [number, track["run"], track["hole"] + 1, f"{place:g}", track["needle_id"], f"{age:.1f}"]
