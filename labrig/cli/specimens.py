"""`labrig specimens`: the blocks of gel that protocols name, their files and tracks."""

from dataclasses import asdict
from typing import Annotated

import typer

from labrig.cli.options import RunsDirOption, find_runs_dir
from labrig.cli.output import AsJson, print_json, print_line, print_table, say, say_wrapped
from labrig.errors import InputError
from labrig.lab.folder import SPECIMENS, find_in_lab
from labrig.protocol.specimen_file import list_specimens, load_specimen
from labrig.protocol.yaml_file import dump_yaml

app = typer.Typer(no_args_is_help=True)


def _complete_name(incomplete: str) -> list[str]:
    return [name for name in list_specimens() if name.startswith(incomplete)]


NameArgument = Annotated[
    str, typer.Argument(metavar="NAME", help="Name of the specimen.", autocompletion=_complete_name)
]


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
        say(f"no specimens in {find_in_lab(SPECIMENS)}; labrig manual specimens says how to write the first")
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
