"""Options that several commands share, and the files that they name."""

from collections.abc import Callable, Sequence
from contextlib import suppress
from itertools import zip_longest
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

import typer

from labrig.cli.output import say
from labrig.lab import RUNS, RUNS_DIR_VARIABLE, choose_runs_dir
from labrig.library.names import (
    CAMPAIGN_PREFIX,
    LAST,
    find_protocol_file,
    find_run_folder,
    list_campaigns,
    list_protocols,
    require_run_folder,
)

RigOption = Annotated[
    Path | None,
    typer.Option(
        "--rig",
        metavar="FILE",
        help="Rig file. Default: $LABRIG_RIG, else calibration/rig-simulated.yaml of the lab folder.",
    ),
]


RunsDirOption = Annotated[
    Path | None,
    typer.Option(
        "--runs-dir",
        metavar="DIR",
        help=f"Folder that holds the runs. Default: ${RUNS_DIR_VARIABLE}, else {RUNS} of the lab folder.",
    ),
]


def find_runs_dir(given: Path | None = None) -> Path:
    """Return the folder of the runs, and say which it is if that cannot be seen from the command line."""
    chosen = choose_runs_dir(given)
    if given is None and chosen.path != RUNS:
        say(f"runs: {chosen.path}, {chosen.reason}")
    return chosen.path


def _name_file(metavar: str, what: str, names: Callable[[], list[str]]) -> Any:
    """Return an argument that names a protocol or a campaign; a campaign's name tells itself by its beginning."""

    def find(given: Path | None) -> Path | None:
        if given is None:
            return None
        return find_protocol_file(given, is_campaign=names is list_campaigns or _is_campaign(given))

    def complete(incomplete: str) -> list[str]:
        return [name for name in names() if name.startswith(incomplete)]

    return typer.Argument(metavar=metavar, help=what, callback=find, autocompletion=complete)


def _is_campaign(given: Path) -> bool:
    return given.name.startswith(CAMPAIGN_PREFIX)


ProtocolArgument = Annotated[
    Path, _name_file("PROTOCOL", "Protocol file (YAML), or its name in the lab folder.", list_protocols)
]
CampaignArgument = Annotated[
    Path,
    _name_file("FILE", "Campaign file (YAML), or its name in the lab folder's protocols.", list_campaigns),
]


def find_run_or_picture(source: Path) -> Path:
    """Return the folder of a run that is named, or a file as it is."""
    return find_run_folder(source, choose_runs_dir().path)


def _complete_run(incomplete: str) -> list[str]:
    """Return the names of runs that begin so, newest first, as the names of most begin with their time."""
    with suppress(OSError):
        runs = choose_runs_dir().path.iterdir()
        names = sorted((path.name for path in runs if path.is_dir()), reverse=True)
        return [name for name in (str(LAST), *names) if name.startswith(incomplete) and name[0] != "."]
    return []


def _name_run(metavar: str) -> Any:
    """Return an argument that names runs."""

    def find(run: Path) -> Path:
        return require_run_folder(run, choose_runs_dir().path)

    def find_all(given: Any) -> Any:
        return [find(run) for run in given] if isinstance(given, list | tuple) else given and find(given)

    help_text = "Folder of a run, or its name in data/runs."
    return typer.Argument(metavar=metavar, help=help_text, callback=find_all, autocompletion=_complete_run)


RunArgument = Annotated[Path, _name_run("RUN")]
RunsArgument = Annotated[list[Path], _name_run("RUN...")]
RunsOrNoneArgument = Annotated[list[Path] | None, _name_run("RUN...")]
SetOption = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="KEY=VALUE",
        help="Override a value of the protocol, or of the rig file with the prefix rig.; repeatable.",
    ),
]
YesOption = Annotated[
    bool, typer.Option("--yes", help="Ask nothing on a simulated rig; a real rig asks all the same.")
]
SeedOption = Annotated[int | None, typer.Option("--seed", help="Override the protocol's seed.")]
LiveKind = Literal["viewer", "web"]
"""The viewer's window, or a page for a browser."""

LiveOption = Annotated[
    LiveKind | None,
    typer.Option(
        "--live", help="Show the run while it is made: --live in the rerun viewer, --live web in a browser."
    ),
]


WorkersOption = Annotated[
    int | None, typer.Option("--workers", min=1, max=1000, help="Processes. Default: one for each core.")
]
ClusterOption = Annotated[
    str | None,
    typer.Option("--cluster", metavar="ADDRESS", help="Workers of a dask scheduler (tcp://HOST:PORT)."),
]

InsertionOption = Annotated[
    Literal["right", "left", "up", "down"],
    typer.Option("--insertion", help="Direction of the insertion in the picture."),
]
OptionalInsertion = Annotated[
    Literal["right", "left", "up", "down"] | None,
    typer.Option("--insertion", help="Direction of the insertion in the picture; with --px-per-mm."),
]

IntrinsicsOption = Annotated[
    Path | None, typer.Option("--intrinsics", metavar="FILE", help="Intrinsics of the camera.")
]
PlaneOption = Annotated[Path | None, typer.Option("--plane", metavar="FILE", help="Plane map of the camera.")]
PxPerMmOption = Annotated[float | None, typer.Option("--px-per-mm", help="Scale of rectified pictures.")]
OriginOption = Annotated[
    tuple[float, float] | None,
    typer.Option("--origin-px", metavar="U V", help="Pixel of the plane's origin."),
]
NeedleDiameterOption = Annotated[
    float, typer.Option("--needle-diameter-mm", help="Outer diameter of the needle.")
]
SheathDiameterOption = Annotated[
    float | None,
    typer.Option("--sheath-diameter-mm", help="Outer diameter of the sheath, if it is in the picture."),
]

DEFAULT_NEEDLE_DIAMETER_MM = 1.2


def complete_live(arguments: Sequence[str]) -> list[str]:
    """Return a command line in which `--live` alone names the viewer; the parser knows no optional values."""
    kinds = get_args(LiveKind)
    completed: list[str] = []
    for word, following in zip_longest(arguments, arguments[1:]):
        completed.append(word)
        if word == "--live" and following not in kinds:
            completed.append(kinds[0])
    return completed
