"""Options that several commands share, and the files that they name."""

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from difflib import get_close_matches
from itertools import zip_longest
from pathlib import Path
from typing import Annotated, Literal, get_args

import typer

from labrig.cli.output import say
from labrig.errors import FileFormatError, InputError
from labrig.lab import (
    CALIBRATION,
    PROTOCOLS,
    RUNS,
    RUNS_DIR_VARIABLE,
    RunsDir,
    choose_runs_dir,
    find_in_lab,
    find_lab_folder,
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

        require_local(chosen.path)
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
    return _find_file(given, is_campaign=given.name.startswith(_CAMPAIGN))


def _find_campaign(given: Path | None) -> Path | None:
    """Return a campaign file as `_find_file`; None if none is given."""
    return None if given is None else _find_file(given, is_campaign=True)


def _find_file(given: Path, *, is_campaign: bool) -> Path:
    """Return the file of a protocol or campaign: the given one, or the one of that name in the lab folder.

    Raises
    ------
    InputError
        When it is a name without suffix, and there is no such protocol; says which was probably meant.
    """
    with suppress(OSError):  # a name that no file can have: whoever reads it says so
        if len(given.parts) == 1 and not given.is_file():
            return _find_in_lab_folder(given, is_campaign=is_campaign)
    return given


def _find_in_lab_folder(name: Path, *, is_campaign: bool) -> Path:
    folder = find_in_lab(PROTOCOLS)
    file = folder / (name if name.suffix else f"{name}{_YAML}")
    if file.is_file() or name.suffix:
        return file if file.is_file() else name
    known = _list_campaigns() if is_campaign else _list_protocols()
    # The beginning that all campaigns share makes no two names alike.
    by_rest = {full.removeprefix(_CAMPAIGN): full for full in known}
    near = [by_rest[rest] for rest in get_close_matches(name.name.removeprefix(_CAMPAIGN), by_rest, 1)]
    if near:
        hint = f"did you mean {near[0]}?"
    elif find_lab_folder() is None:
        hint = "there is no lab folder here or above; make one, with example protocols: labrig init FOLDER"
    else:
        hint = f"there are {', '.join(known)}" if known else "labrig init adds the examples"
    kind = "campaign" if is_campaign else "protocol"
    raise InputError(f"there is no {kind} {name}, neither here nor in {folder}", hint)


def _list_protocols() -> list[str]:
    """Return the names of the protocols in the lab folder."""
    return [name for name in _list_files() if not name.startswith(_CAMPAIGN)]


def _list_campaigns() -> list[str]:
    """Return the names of the campaign files in the lab folder."""
    return [name for name in _list_files() if name.startswith(_CAMPAIGN)]


def _list_files() -> list[str]:
    return sorted(path.stem for path in find_in_lab(PROTOCOLS).glob(f"*{_YAML}"))


def _complete_protocol(incomplete: str) -> list[str]:
    return [name for name in _list_protocols() if name.startswith(incomplete)]


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
        autocompletion=lambda incomplete: [name for name in _list_campaigns() if name.startswith(incomplete)],
        show_default=False,
    ),
]


_LAST = Path("last")
_YAML = ".yaml"
_CAMPAIGN = "campaign-"
"""What the names of campaign files begin with, among the protocols."""


def find_run_folder(run: Path, runs_dir: Path) -> Path:
    """Return the folder of a run that is given by its folder, its name in `runs_dir`, or `last`, the newest there."""
    named = runs_dir / run
    if run == _LAST and not run.exists() and not named.exists():
        from labrig.record.catalogue import list_runs

        listed = list_runs(runs_dir)
        return listed[0].run if listed else run
    return named if len(run.parts) == 1 and not run.exists() and named.is_dir() else run


def require_run_folder(run: Path, runs_dir: Path) -> Path:
    """Return the folder of a run as `find_run_folder` does.

    Raises
    ------
    InputError
        When a name is neither here nor in `runs_dir`; says which name was probably meant.
    """
    folder = find_run_folder(run, runs_dir)
    if folder.exists() or len(run.parts) != 1:
        return folder
    known = [path.name for path in runs_dir.iterdir()] if runs_dir.is_dir() else []
    near = get_close_matches(run.name, known, 1)
    raise InputError(
        f"there is no run {run}, neither here nor in {runs_dir}",
        f"did you mean {near[0]}?" if near else "labrig runs lists them",
    )


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
        return [name for name in (str(_LAST), *names) if name.startswith(incomplete) and name[0] != "."]
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
NoPauseOption = Annotated[
    bool, typer.Option("--no-pause", help="Stop at the first Ctrl+C instead of pausing at a safe point.")
]
QuietOption = Annotated[bool, typer.Option("--quiet", help="Ring no bell when somebody is waited for.")]
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

VerboseOption = Annotated[
    bool, typer.Option("--verbose", "-v", help="Tell each event of the run on standard error as it comes.")
]

MaskOption = Annotated[
    Path | None,
    typer.Option(
        "--mask",
        metavar="FILE",
        help="Pixels that are not the needle: a picture that is white there, or polygons as JSON.",
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
SIMULATED_RIG = CALIBRATION / "rig-simulated.yaml"
_RIG_PREFIX = "rig."


def complete_live(arguments: Sequence[str]) -> list[str]:
    """Return a command line in which `--live` alone names the viewer; the parser knows no optional values."""
    kinds = get_args(LiveKind)
    completed: list[str] = []
    for word, following in zip_longest(arguments, arguments[1:]):
        completed.append(word)
        if word == "--live" and following not in kinds:
            completed.append(kinds[0])
    return completed


def find_named_rig_file(given: Path | None) -> Path | None:
    """Return the given rig file, else $LABRIG_RIG; None if neither names any."""
    if given is None and os.environ.get("LABRIG_RIG"):
        return Path(os.environ["LABRIG_RIG"])
    return given


def find_rig_file(given: Path | None, protocol: Path | None = None) -> Path:
    """Return the rig file: the given file, $LABRIG_RIG, or the simulated rig of the lab folder.

    Without a lab folder, the simulated rig is searched for below the working folder, then beside the folder of the
    protocol.
    """
    named = find_named_rig_file(given)
    if named is not None:
        return named
    candidates = [find_in_lab(SIMULATED_RIG)]
    if protocol is not None:
        candidates.append(protocol.resolve().parent.parent / SIMULATED_RIG)
    for candidate in candidates:
        if candidate.is_file():
            return candidate
    raise InputError(
        f"no rig file given, and {candidates[0]} is not here",
        "name one with --rig FILE, or make a lab folder: labrig init FOLDER",
    )


@contextmanager
def restore_rig_prefix() -> Iterator[None]:
    """Report faults of rig overrides as they were typed, with the prefix that `split_overrides` removed."""
    try:
        yield
    except FileFormatError as error:
        typed = (
            replace(problem, where=problem.where.replace("--set ", f"--set {_RIG_PREFIX}", 1))
            for problem in error.problems
        )
        raise FileFormatError(tuple(typed)) from error


def split_overrides(settings: Sequence[str]) -> tuple[list[str], list[str]]:
    """Split `--set` values into those of the protocol and those of the rig file, without the prefix `rig.`."""
    rig = [setting.removeprefix(_RIG_PREFIX) for setting in settings if setting.startswith(_RIG_PREFIX)]
    return [setting for setting in settings if not setting.startswith(_RIG_PREFIX)], rig
