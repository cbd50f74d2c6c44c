"""Options that several commands share, and the files that they name."""

from collections.abc import Sequence
from contextlib import suppress
from itertools import zip_longest
from pathlib import Path
from typing import Annotated, Literal, get_args

import typer

from labrig.cli.output import say
from labrig.errors import InputError
from labrig.lab import RUNS, RUNS_DIR_VARIABLE, RunsDir, choose_runs_dir
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
        show_default=False,
    ),
]


RunsDirOption = Annotated[
    Path | None,
    typer.Option(
        "--runs-dir",
        metavar="DIR",
        help=f"Folder that holds the runs. Default: ${RUNS_DIR_VARIABLE}, else {RUNS} of the lab folder.",
        show_default=False,
    ),
]


def choose_local_runs_dir(given: Path | None) -> RunsDir:
    """Return the folder of the runs as `choose_runs_dir` does.

    Raises
    ------
    InputError
        When it is a URL: a live run writes on the local disk.
    """
    chosen = choose_runs_dir(given)
    if ":" in str(chosen.path):
        from labrig.record.remote import require_local

        try:
            require_local(chosen.path)
        except InputError as error:
            raise error.reword(f"{error.message}, {chosen.reason}") from error
    return chosen


def find_runs_dir(given: Path | None) -> Path:
    """Return the folder of the runs, and say which it is if that cannot be seen from the command line.

    Raises `InputError` as `choose_local_runs_dir`.
    """
    chosen = choose_local_runs_dir(given)
    if given is None and chosen.path != RUNS:
        say(f"runs: {chosen.path}, {chosen.reason}")
    return chosen.path


def _find_protocol(given: Path) -> Path:
    """Return a protocol file as `_find_file`; the name of a campaign tells itself by its beginning."""
    return find_protocol_file(given, is_campaign=given.name.startswith(CAMPAIGN_PREFIX))


def _find_campaign(given: Path | None) -> Path | None:
    """Return a campaign file as `_find_file`; None if none is given."""
    return None if given is None else find_protocol_file(given, is_campaign=True)


def _complete_protocol(incomplete: str) -> list[str]:
    return [name for name in list_protocols() if name.startswith(incomplete)]


ProtocolArgument = Annotated[
    Path,
    typer.Argument(
        metavar="PROTOCOL",
        help="Protocol file (YAML), or its name in the lab folder.",
        callback=_find_protocol,
        autocompletion=_complete_protocol,
    ),
]


CampaignArgument = Annotated[
    Path,
    typer.Argument(
        metavar="FILE",
        help="Campaign file (YAML), or its name in the lab folder's protocols.",
        callback=_find_campaign,
        autocompletion=lambda incomplete: [name for name in list_campaigns() if name.startswith(incomplete)],
        show_default=False,
    ),
]


def _find_run(run: Path) -> Path:
    return require_run_folder(run, choose_runs_dir().path)


def _find_run_or_url(run: str) -> str:
    return run if ":" in run else str(_find_run(Path(run)))


def find_run_or_picture(source: Path) -> Path:
    """Return the folder of a run that is named, or a file as it is."""
    return find_run_folder(source, choose_runs_dir().path)


def _find_all(runs: list[Path]) -> list[Path]:
    return [_find_run(run) for run in runs]


def _find_local(run: Path) -> Path:
    """Refuse a URL: this command writes into the run."""
    if ":" in str(run):
        from labrig.record.remote import require_local

        require_local(run)
    return _find_run(run)


def _find_all_local(runs: list[Path]) -> list[Path]:
    return [_find_local(run) for run in runs]


def _complete_run(incomplete: str) -> list[str]:
    """Return the names of runs that begin so, newest first, as the names of most begin with their time."""
    with suppress(OSError):
        runs = choose_runs_dir().path.iterdir()
        names = sorted((path.name for path in runs if path.is_dir()), reverse=True)
        return [name for name in (str(LAST), *names) if name.startswith(incomplete) and name[0] != "."]
    return []


RunArgument = Annotated[
    Path,
    typer.Argument(
        metavar="RUN",
        help="Folder of a run, its name in data/runs, or its URL.",
        callback=_find_run,
        autocompletion=_complete_run,
    ),
]
RunUrlArgument = Annotated[
    str,
    typer.Argument(
        metavar="RUN",
        help="Folder of a run, its name in data/runs, or its URL.",
        callback=_find_run_or_url,
        autocompletion=_complete_run,
    ),
]
RunsArgument = Annotated[
    list[Path],
    typer.Argument(
        metavar="RUN...",
        help="Folders of runs, their names in data/runs, or URLs.",
        callback=_find_all,
        autocompletion=_complete_run,
    ),
]
LocalRunsOrNoneArgument = Annotated[
    list[Path] | None,
    typer.Argument(
        metavar="RUN...",
        help="Folders of runs, or their names in data/runs.",
        callback=lambda given: _find_all_local(given or []),
        autocompletion=_complete_run,
        show_default=False,
    ),
]
LocalRunArgument = Annotated[
    Path,
    typer.Argument(
        metavar="RUN",
        help="Folder of a run, or its name in data/runs.",
        callback=_find_local,
        autocompletion=_complete_run,
    ),
]
LocalRunsArgument = Annotated[
    list[Path],
    typer.Argument(
        metavar="RUN...",
        help="Folders of runs, or their names in data/runs.",
        callback=_find_all_local,
        autocompletion=_complete_run,
    ),
]
SetOption = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="KEY=VALUE",
        help="Override a value of the protocol, or of the rig file with the prefix rig.; repeatable.",
        show_default=False,
    ),
]
YesOption = Annotated[
    bool, typer.Option("--yes", help="Ask nothing on a simulated rig; a real rig asks all the same.")
]
SeedOption = Annotated[
    int | None, typer.Option("--seed", help="Override the protocol's seed.", show_default=False)
]
LiveKind = Literal["viewer", "web"]
"""The viewer's window, or a page for a browser."""

LiveOption = Annotated[
    LiveKind | None,
    typer.Option(
        "--live",
        help="Show the run while it is made: --live in the rerun viewer, --live web in a browser.",
        show_default=False,
    ),
]


WorkersOption = Annotated[
    int | None,
    typer.Option(
        "--workers", min=1, max=1000, help="Processes. Default: one for each core.", show_default=False
    ),
]
ClusterOption = Annotated[
    str | None,
    typer.Option(
        "--cluster",
        metavar="ADDRESS",
        help="Workers of a dask scheduler (tcp://HOST:PORT).",
        show_default=False,
    ),
]

InsertionOption = Annotated[
    Literal["right", "left", "up", "down"],
    typer.Option("--insertion", help="Direction of the insertion in the picture."),
]
OptionalInsertion = Annotated[
    Literal["right", "left", "up", "down"] | None,
    typer.Option(
        "--insertion", help="Direction of the insertion in the picture; with --px-per-mm.", show_default=False
    ),
]

IntrinsicsOption = Annotated[
    Path | None,
    typer.Option("--intrinsics", metavar="FILE", help="Intrinsics of the camera.", show_default=False),
]
PlaneOption = Annotated[
    Path | None, typer.Option("--plane", metavar="FILE", help="Plane map of the camera.", show_default=False)
]
PxPerMmOption = Annotated[
    float | None, typer.Option("--px-per-mm", help="Scale of rectified pictures.", show_default=False)
]
OriginOption = Annotated[
    tuple[float, float] | None,
    typer.Option("--origin-px", metavar="U V", help="Pixel of the plane's origin.", show_default=False),
]
NeedleDiameterOption = Annotated[
    float, typer.Option("--needle-diameter-mm", help="Outer diameter of the needle.")
]
SheathDiameterOption = Annotated[
    float | None,
    typer.Option(
        "--sheath-diameter-mm",
        help="Outer diameter of the sheath, if it is in the picture.",
        show_default=False,
    ),
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
