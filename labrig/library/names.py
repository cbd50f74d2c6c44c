"""What a person names: protocols, campaigns, rig files and runs, by their files or by their names in the lab folder."""

import os
from contextlib import suppress
from difflib import get_close_matches
from pathlib import Path

from labrig.errors import InputError
from labrig.lab import CALIBRATION, PROTOCOLS, find_in_lab, find_lab_folder
from labrig.record.layout import MANIFEST

LAST = Path("last")
SIMULATED_RIG = CALIBRATION / "rig-simulated.yaml"
CAMPAIGN_PREFIX = "campaign-"
"""What the names of campaign files begin with, among the protocols."""
_YAML = ".yaml"


def find_protocol_file(given: Path, *, is_campaign: bool) -> Path:
    """Return the file of a protocol or campaign: the given one, or the one of that name in the lab folder.

    Raises
    ------
    InputError
        When the lab folder has no such protocol; says which was probably meant.
    """
    with suppress(OSError):  # a name that no file can have: whoever reads it says so
        if not given.is_file() and (len(given.parts) == 1 or given.parent == find_in_lab(PROTOCOLS)):
            return _find_in_lab_folder(Path(given.name), is_campaign=is_campaign)
    return given


def _find_in_lab_folder(name: Path, *, is_campaign: bool) -> Path:
    folder = find_in_lab(PROTOCOLS)
    file = folder / (name if name.suffix else f"{name}{_YAML}")
    if file.is_file() or name.exists():
        return file if file.is_file() else name
    known = list_campaigns() if is_campaign else list_protocols()
    # The beginning that all campaigns share makes no two names alike.
    by_rest = {full.removeprefix(CAMPAIGN_PREFIX): full for full in known}
    near = [by_rest[rest] for rest in get_close_matches(name.stem.removeprefix(CAMPAIGN_PREFIX), by_rest, 1)]
    if near:
        hint = f"did you mean {near[0]}?"
    elif find_lab_folder() is None:
        hint = "there is no lab folder here or above; make one, with example protocols: labrig init FOLDER"
    else:
        hint = f"there are {', '.join(known)}" if known else "labrig init adds the examples"
    kind = "campaign" if is_campaign else "protocol"
    raise InputError(f"there is no {kind} {name}, neither here nor in {folder}", hint)


def list_protocols() -> list[str]:
    """Return the names of the protocols in the lab folder."""
    return [name for name in _list_files() if not name.startswith(CAMPAIGN_PREFIX)]


def list_campaigns() -> list[str]:
    """Return the names of the campaign files in the lab folder."""
    return [name for name in _list_files() if name.startswith(CAMPAIGN_PREFIX)]


def _list_files() -> list[str]:
    return sorted(path.stem for path in find_in_lab(PROTOCOLS).glob(f"*{_YAML}"))


def find_run_folder(run: Path, runs_dir: Path) -> Path:
    """Return the folder of a run that is given by its folder, its name in `runs_dir`, or `last`, the newest there."""
    named = runs_dir / run
    if run == LAST and not run.exists() and not named.exists():
        from labrig.record.catalogue import list_runs

        listed = list_runs(runs_dir)
        return listed[0].run if listed else run
    # A folder here that is no run, such as `calibration`, does not hide the run of that name.
    return named if len(run.parts) == 1 and not (run / MANIFEST).exists() and named.is_dir() else run


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


def find_named_rig_file(given: Path | None) -> Path | None:
    """Return the given rig file, else $LABRIG_RIG; None if neither names any."""
    if given is None and os.environ.get("LABRIG_RIG"):
        return Path(os.environ["LABRIG_RIG"])
    return given


def find_rig_file(given: Path | None, protocol: Path | None = None) -> Path:
    """Return the rig file: the given file, $LABRIG_RIG, or the simulated rig of the lab folder.

    Without a lab folder, the simulated rig is searched for below the working folder, then beside the folder of the
    protocol.

    Raises
    ------
    InputError
        When there is none.
    """
    named = find_named_rig_file(given)
    if named is not None:
        with suppress(OSError):  # a name that no file can have: whoever reads it says so
            if not named.exists():
                known = sorted(map(str, find_in_lab(CALIBRATION).glob(f"*{_YAML}")))
                there = f"there are {', '.join(known)}; " if known else ""
                raise InputError(f"there is no rig file {named}", f"{there}see: labrig manual rig")
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
