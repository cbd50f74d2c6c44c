"""The lab folder: where commands read and write, and the examples that it starts with.

The examples are the folders `protocols` and `calibration` of the checkout, which a wheel holds in `labrig/examples`.
"""

import json
import os
import shlex
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from labrig.durable import disk_errors, write_atomically
from labrig.errors import OutputExistsError

PROTOCOLS = Path("protocols")
CALIBRATION = Path("calibration")
RUNS = Path("data/runs")
SPECIMENS = Path("data/specimens")
COMPARISONS = Path("data/comparisons")
CAMPAIGNS = Path("data/campaigns")
EXPORTS = Path("data/exports")
PROTOCOL_SCHEMA = PROTOCOLS / "protocol.schema.json"
CAMPAIGN_SCHEMA = PROTOCOLS / "campaign.schema.json"
RIG_SCHEMA = CALIBRATION / "rig.schema.json"
SPECIMEN_SCHEMA = SPECIMENS / "specimen.schema.json"
RUNS_DIR_VARIABLE = "LABRIG_RUNS_DIR"

_PACKAGE = Path(__file__).parent
_NOTEBOOK = "first-sweep.ipynb"
_IGNORED = """\
# Records and what is made from them are kept by a backup, not by git.
/data/runs/
/data/comparisons/
/data/campaigns/
/data/exports/
# What a rig remembers between runs.
*state.json*
"""
_EDITOR = {
    "yaml.schemas": {
        PROTOCOL_SCHEMA.as_posix(): [f"{PROTOCOLS}/*.yaml", f"!{PROTOCOLS}/campaign-*.yaml"],
        CAMPAIGN_SCHEMA.as_posix(): f"{PROTOCOLS}/campaign-*.yaml",
        RIG_SCHEMA.as_posix(): f"{CALIBRATION}/rig*.yaml",
        SPECIMEN_SCHEMA.as_posix(): f"{SPECIMENS}/*.yaml",
    }
}
_EXTENSIONS = {"recommendations": ["redhat.vscode-yaml"]}


def is_lab_folder(folder: Path) -> bool:
    """Return whether a folder is that of a lab: both schemas stand where labrig keeps them."""
    try:
        return all((folder / schema).is_file() for schema in (PROTOCOL_SCHEMA, RIG_SCHEMA))
    except OSError:  # a folder above that this account may not read
        return False


def find_lab_folder(start: Path = Path()) -> Path | None:
    """Return the nearest lab folder that is or holds `start`, relative to the working folder; None if there is none."""
    try:
        here = start.resolve()
        found = next((folder for folder in (here, *here.parents) if is_lab_folder(folder)), None)
        return None if found is None else Path(os.path.relpath(found))
    except FileNotFoundError:  # the working folder has been deleted
        return None


def find_in_lab(path: Path) -> Path:
    """Return a path that is relative to the lab folder; without a lab folder, relative to the working folder."""
    lab = find_lab_folder()
    return path if lab is None else lab / path


@dataclass(frozen=True)
class RunsDir:
    """The folder of the runs, and what decided that: the end of a sentence, for people."""

    path: Path
    reason: str


def choose_runs_dir(given: Path | None = None) -> RunsDir:
    """Return the folder of the runs.

    Parameters
    ----------
    given : Path or None
        The folder that `--runs-dir` names, if it does.
    """
    if given is not None:
        return RunsDir(given, "as --runs-dir says")
    named = os.environ.get(RUNS_DIR_VARIABLE)
    if named:
        return RunsDir(Path(named), f"as {RUNS_DIR_VARIABLE} says")
    lab = find_lab_folder()
    if lab is None:
        return RunsDir(RUNS, "below the working folder, as no lab folder is here or above")
    return RunsDir(lab / RUNS, f"in the lab folder {lab.resolve()}")


def read_examples() -> dict[str, bytes]:
    """Return the content of every example by its place in a lab folder, such as `protocols/steerability.yaml`."""
    packed = _PACKAGE / "examples"
    root = packed if packed.is_dir() else _PACKAGE.parent
    found = {file.relative_to(root).as_posix(): file.read_bytes() for file in list_examples(root)}
    return {**found, _NOTEBOOK: (_PACKAGE / "manual" / "example" / _NOTEBOOK).read_bytes()}


def list_examples(root: Path) -> Iterator[Path]:
    """Yield the examples below a folder: no schemas, which `init` writes, and not what a rig remembers."""
    for folder in (PROTOCOLS, CALIBRATION):
        for file in sorted((root / folder).iterdir()):
            if file.suffix in {".yaml", ".json", ".png"} and not {".schema", ".state"} & set(file.suffixes):
                yield file
    yield root / "data" / "read_run.m"


def make_lab_folder(folder: Path, files: Mapping[str, bytes]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Make a lab folder in a new or an empty folder, or add to one what it lacks.

    No file is replaced but the schemas, which nobody writes by hand. Hidden files may stand in the folder.

    Parameters
    ----------
    files : mapping of str to bytes
        Examples and schemas by their place.

    Returns
    -------
    tuple of str, tuple of str
        The files that were written, and those that were there and differ.

    Raises
    ------
    OutputExistsError
        When it is a file, or holds files and is no lab folder.
    DiskError
        When it cannot be written; the same call goes on.
    """
    _require_free(folder)
    every = {
        **files,
        ".gitignore": _IGNORED.encode("utf-8"),
        ".vscode/settings.json": _dump(_EDITOR),
        ".vscode/extensions.json": _dump(_EXTENSIONS),
    }
    # The schemas first: by them a folder of which only a part could be written is known as a lab's.
    places = sorted(every, key=lambda place: not place.endswith(".schema.json"))
    written, kept = [], []
    with disk_errors(folder):
        (folder / RUNS).mkdir(parents=True, exist_ok=True)
    for place in places:
        path = folder / place
        with disk_errors(path):
            same = path.exists() and path.read_bytes() == every[place]
            if path.exists() and not place.endswith(".schema.json"):
                kept += [] if same else [place]
            elif not same:
                path.parent.mkdir(parents=True, exist_ok=True)
                write_atomically(path, every[place])
                written.append(place)
    return tuple(written), tuple(kept)


def _require_free(folder: Path) -> None:
    with disk_errors(folder):
        if folder.exists() and not folder.is_dir():
            raise OutputExistsError(f"{folder} is a file", "name a new folder: labrig init FOLDER")
        others = sorted(entry.name for entry in folder.iterdir()) if folder.exists() else []
    others = [name for name in others if not name.startswith(".")]
    if others and not any((folder / schema).exists() for schema in (PROTOCOL_SCHEMA, RIG_SCHEMA)):
        named = ", ".join(others[:3]) + (" ..." if others[3:] else "")
        raise OutputExistsError(
            f"{folder.resolve()} holds other files: {named}",
            f"name a new folder: labrig init {shlex.quote(str(folder / 'lab'))}",
        )


def _dump(document: object) -> bytes:
    return (json.dumps(document, indent=2) + "\n").encode("utf-8")
