"""Options that several commands share, and the files that they name."""

from collections.abc import Callable, Sequence
from contextlib import suppress
from itertools import chain
from pathlib import Path
from typing import Annotated, Any, Literal, TypeAlias, get_args

from typer import Argument, Option

from labrig.cli.output import say
from labrig.lab import RUNS, choose_runs_dir
from labrig.library.names import (
    CAMPAIGN_PREFIX,
    LAST,
    find_protocol_file,
    list_campaigns,
    list_protocols,
    require_run_folder,
)

Direction: TypeAlias = Literal["right", "left", "up", "down"]
LiveKind: TypeAlias = Literal["viewer", "web"]
"""The viewer's window, or a page for a browser."""


def find_runs_dir(given: Path | None = None) -> Path:
    """Return the folder of the runs, and say which it is if that cannot be seen from the command line."""
    chosen = choose_runs_dir(given)
    if given is None and chosen.path != RUNS:
        say(f"runs: {chosen.path}, {chosen.reason}")
    return chosen.path


def _name_file(metavar: str, what: str, names: Callable[[], list[str]]) -> Any:
    """Return an argument that names a protocol or a campaign; a campaign's name tells itself by its beginning."""

    def find(given: Path) -> Path:
        is_campaign = names is list_campaigns or given.name.startswith(CAMPAIGN_PREFIX)
        return find_protocol_file(given, is_campaign=is_campaign)

    def complete(incomplete: str) -> list[str]:
        return [name for name in names() if name.startswith(incomplete)]

    return Argument(metavar=metavar, help=what, callback=find, autocompletion=complete)


def _complete_run(incomplete: str) -> list[str]:
    """Return the names of runs that begin so, newest first, as the names of most begin with their time."""
    names: list[str] = []
    with suppress(OSError):
        names = sorted((run.name for run in choose_runs_dir().path.iterdir() if run.is_dir()), reverse=True)
    return [name for name in (str(LAST), *names) if name.startswith(incomplete) and name[0] != "."]


def _find_runs(given: Any) -> Any:
    """Return the folder of a run that is named, or of each."""
    if isinstance(given, list | tuple):
        return [_find_runs(run) for run in given]
    return require_run_folder(given, choose_runs_dir().path)


_RUN: Any = {"help": "Folder of a run, its name in data/runs, or last.", "autocompletion": _complete_run}
ProtocolArgument = Annotated[
    Path, _name_file("PROTOCOL", "Protocol file, or its name in the lab folder.", list_protocols)
]
CampaignArgument = Annotated[
    Path, _name_file("FILE", "Campaign file, or its name in the lab folder.", list_campaigns)
]
RunArgument = Annotated[Path, Argument(metavar="RUN", callback=_find_runs, **_RUN)]
RunsArgument = Annotated[list[Path], Argument(metavar="RUN...", callback=_find_runs, **_RUN)]
RunsOrNoneArgument = Annotated[list[Path] | None, Argument(metavar="RUN...", **_RUN)]
"""As it is typed: `choose_runs` finds them."""

_RIG_HELP = "Rig file. Default: $LABRIG_RIG, else calibration/rig-simulated.yaml of the lab folder."
RigOption = Annotated[Path | None, Option(metavar="FILE", help=_RIG_HELP)]
_RUNS_DIR_HELP = "Folder of the runs. Default: $LABRIG_RUNS_DIR, else data/runs of the lab folder."
RunsDirOption = Annotated[Path | None, Option(metavar="DIR", help=_RUNS_DIR_HELP)]
_WHERE_HELP = (
    'Take the runs that fit, whole, with all their gels, such as "gelatin_percent=13 and exit_status=success". '
    "Operators: = != < <= > >= ~ (contains), and, or, not, brackets."
)
WhereOption = Annotated[str | None, Option(metavar="CONDITION", help=_WHERE_HELP)]
_SET_HELP = "Override a value of the protocol, or of the rig file with the prefix rig.; repeatable."
SetOption = Annotated[list[str] | None, Option("--set", metavar="KEY=VALUE", help=_SET_HELP)]
SeedOption = Annotated[int | None, Option(help="Override the protocol's seed.")]
LiveOption = Annotated[
    LiveKind | None,
    Option(help="Show the run while it is made: in the rerun viewer, or with web in a browser."),
]
WorkersOption = Annotated[int | None, Option(min=1, max=1000, help="Processes. Default: one a core.")]

InsertionOption = Annotated[Direction, Option(help="Direction of the insertion in the picture.")]
IntrinsicsOption = Annotated[Path | None, Option(metavar="FILE", help="Intrinsics of the camera.")]
PlaneOption = Annotated[Path | None, Option(metavar="FILE", help="Plane map of the camera.")]
PxPerMmOption = Annotated[float | None, Option(help="Scale of rectified pictures.")]
OriginOption = Annotated[
    tuple[float, float] | None, Option(metavar="U V", help="Pixel of the plane's origin; with --px-per-mm.")
]
OptionalInsertion = Annotated[
    Direction | None, Option(help="Direction of the insertion in the picture; with --px-per-mm.")
]
NeedleDiameterOption = Annotated[float, Option(help="Outer diameter of the needle.")]
SheathDiameterOption = Annotated[float | None, Option(help="Outer diameter of the sheath, if it is seen.")]
DEFAULT_NEEDLE_DIAMETER_MM = 1.2


def complete_live(arguments: Sequence[str]) -> list[str]:
    """Return a command line in which `--live` alone names the viewer; the parser knows no optional values."""
    viewer, *_ = kinds = get_args(LiveKind)
    named = zip(arguments, (*arguments[1:], ""), strict=False)  # empty without arguments
    completed = (
        (word, viewer) if word == "--live" and after not in kinds else (word,) for word, after in named
    )
    return list(chain.from_iterable(completed))
