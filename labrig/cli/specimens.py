"""`labrig specimens`: the blocks of gel that protocols name, their files and tracks."""

from dataclasses import asdict
from typing import Annotated, Any

from typer import Argument

from labrig.cli.options import find_runs_dir
from labrig.cli.output import print_json, print_line, print_table, say


def _complete_name(incomplete: str) -> list[str]:
    from labrig.protocol.specimen_file import list_specimens

    return [name for name in list_specimens() if name.startswith(incomplete)]


def specimens(
    name: Annotated[
        str | None, Argument(metavar="[NAME]", help="Show this one.", autocompletion=_complete_name)
    ] = None,
) -> None:
    """List the specimens of data/specimens; of one, its file and the tracks that real and simulated runs left in it."""
    if name is None:
        _list()
    else:
        _show(name)


def _list() -> None:
    """Print what the files of the specimens say; a file that cannot be read is named."""
    from labrig.errors import InputError
    from labrig.protocol.specimen_file import list_specimens, load_specimen

    rows = []
    for name in list_specimens():
        try:
            rows.append(load_specimen(name)[0].model_dump(mode="json"))
        except InputError as error:
            say(f"note: {error.message}")
    print_json(rows)
    if not rows:
        say("no specimens in data/specimens; labrig manual protocol says how to write the first")
    keys = ("name", "gelatin_percent", "batch", "cast_on", "usable_until")
    heads = ("specimen", "gelatin %", "batch", "cast", "usable until")
    shown = [{**row, "gelatin_percent": f"{row['gelatin_percent']:g}"} for row in rows]
    print_table(heads, [[row[key] for key in keys] for row in shown])


def _show(name: str) -> None:
    """Print the file of a specimen, and its tracks."""
    from labrig.library.specimens import find_tracks
    from labrig.protocol.specimen_file import load_specimen

    specimen, sha256 = load_specimen(name)
    folder, document = find_runs_dir(), specimen.model_dump(mode="json")
    for key, value in document.items():
        if value is not None:
            print_line(f"{key}: {value}")
    tracks: dict[str, list[dict[str, Any]]] = {}
    unread: dict[str, dict[str, Any]] = {}
    for kind in ("real", "simulated"):
        held = find_tracks(folder, [name], simulated=kind == "simulated")
        unread |= {problem.where: asdict(problem) for problem in held.unread}
        tracks[kind] = [track.model_dump(mode="json") for track in held.tracks[name]]
        if tracks[kind]:
            print_line(f"\ntracks of {kind} runs:")
            heads = ("track", "run", "hole", "place mm", "needle", "age h")
            print_table(heads, [_list_cells(number, one) for number, one in enumerate(tracks[kind], start=1)])
    print_json({**document, "sha256": sha256, "tracks": tracks, "unread": list(unread.values())})
    for problem in unread.values():
        say(f"note: {problem['where']}: its tracks are not known: {problem['message']}")
    if not (any(tracks.values()) or unread):
        say(f"no run in {folder} has inserted into it")


def _list_cells(number: int, track: dict[str, Any]) -> list[object]:
    place, age = track["hole_position_mm"], track["age_h"]
    return [number, track["run"], track["hole"] + 1, f"{place:g}", track["needle_id"], f"{age:.1f}"]
