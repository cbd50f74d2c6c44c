"""Makes a lab folder, and brings one of an older labrig up to date; replaces no file that somebody has changed."""

import json
import shlex
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path

from labrig.durable import disk_errors, write_atomically
from labrig.errors import InputError, OutputExistsError
from labrig.input_file import read_file
from labrig.lab.folder import (
    CAMPAIGN_SCHEMA,
    MARKER,
    PROTOCOL_SCHEMA,
    PROTOCOLS,
    RIG_SCHEMA,
    RUNS,
    SPECIMEN_SCHEMA,
    SPECIMENS,
    is_lab_folder,
)
from labrig.lab.marker import Marker, hash_content, make_marker, read_marker

SCHEMAS = tuple(
    schema.as_posix() for schema in (PROTOCOL_SCHEMA, CAMPAIGN_SCHEMA, RIG_SCHEMA, SPECIMEN_SCHEMA)
)

_IGNORED = """\
# Records and what is made from them are kept by a backup, not by git.
/data/runs/
/data/comparisons/
/data/campaigns/
# What a rig remembers between runs.
/calibration/state.json*
*.state.json*
"""
_EDITOR = {
    "yaml.schemas": {
        PROTOCOL_SCHEMA.as_posix(): [f"{PROTOCOLS}/*.yaml", f"!{PROTOCOLS}/campaign-*.yaml"],
        CAMPAIGN_SCHEMA.as_posix(): f"{PROTOCOLS}/campaign-*.yaml",
        RIG_SCHEMA.as_posix(): "calibration/rig*.yaml",
        SPECIMEN_SCHEMA.as_posix(): f"{SPECIMENS}/*.yaml",
    }
}
_EXTENSIONS = {"recommendations": ["redhat.vscode-yaml"]}


@dataclass(frozen=True)
class Written:
    """What was done with each file of a lab folder, by its place in it.

    Attributes
    ----------
    added, replaced : tuple of str
        Files that labrig wrote.
    kept : tuple of str
        Files of which labrig has another version now, and that somebody has changed.
    """

    added: tuple[str, ...] = ()
    replaced: tuple[str, ...] = ()
    kept: tuple[str, ...] = ()


def list_lab_files(examples: Mapping[str, bytes]) -> dict[str, bytes]:
    """Return the files of a lab folder: the examples, and what git and an editor read."""
    return {
        **examples,
        ".gitignore": _IGNORED.encode("utf-8"),
        ".vscode/settings.json": _dump(_EDITOR),
        ".vscode/extensions.json": _dump(_EXTENSIONS),
    }


def _dump(document: object) -> bytes:
    return (json.dumps(document, indent=2) + "\n").encode("utf-8")


def make_lab_folder(folder: Path, files: Mapping[str, bytes], labrig: str) -> Written:
    """Make a lab folder in a new or an empty folder; hidden files may be there, and are kept.

    Parameters
    ----------
    files : mapping of str to bytes
        As from `list_lab_files`.
    labrig : str
        The version of this labrig.

    Raises
    ------
    OutputExistsError
        When it is a lab folder already, holds other files, or is a file.
    DiskError
        When it cannot be written. What is there by then is a lab folder, which an update completes.
    """
    _require_free(folder, labrig)
    # First, so that a lab folder of which only a part could be written is known as one.
    _write(folder, MARKER, make_marker(labrig, files).encode())
    kept = tuple(place for place in files if (folder / place).exists())
    added = tuple(place for place in files if place not in kept)
    _write_all(folder, files, added)
    return Written(added=added, kept=kept)


def _require_free(folder: Path, labrig: str) -> None:
    if is_lab_folder(folder):
        marker = _read_usable_marker(folder, labrig)
        made_by = "" if marker is None else f", made by labrig {marker.labrig}"
        raise OutputExistsError(
            f"{_name(folder)} is a lab folder already{made_by}",
            f"bring it up to date: {suggest_update(folder)}",
        )
    with disk_errors(folder):
        if folder.exists() and not folder.is_dir():
            raise OutputExistsError(f"{folder} is a file", "name a new folder: labrig init FOLDER")
        others = sorted(entry.name for entry in folder.iterdir()) if folder.exists() else []
    others = [name for name in others if not name.startswith(".")]
    if others:
        named = ", ".join(others[:3]) + (" ..." if others[3:] else "")
        raise OutputExistsError(
            f"{_name(folder)} holds other files: {named}",
            f"name a new folder: labrig init {shlex.quote(str(folder / 'lab'))}",
        )


def update_lab_folder(folder: Path, files: Mapping[str, bytes], labrig: str) -> Written:
    """Bring a lab folder up to date: add files, replace schemas and the examples that nobody has changed.

    Parameters
    ----------
    files, labrig
        As for `make_lab_folder`.

    Raises
    ------
    InputError
        When it is no lab folder, its marker is damaged, or a newer labrig made it.
    DiskError
        When it cannot be written; the same command completes it.
    """
    if not is_lab_folder(folder):
        raise InputError(
            f"{_name(folder)} is not a lab folder", f"make one: labrig init {shlex.quote(str(folder))}"
        )
    marker = _read_usable_marker(folder, labrig)
    former = {} if marker is None else marker.files
    found = {place: hash_content(_read(folder / place)) for place in files if (folder / place).exists()}
    new = make_marker(labrig, files).files
    differing = [place for place in found if found[place] != new[place]]
    written = Written(
        added=tuple(place for place in files if place not in found),
        replaced=tuple(place for place in differing if place in SCHEMAS or found[place] == former.get(place)),
        kept=tuple(_list_changed(differing, found, former, new)),
    )
    _write_all(folder, files, (*written.added, *written.replaced))
    # Last: after an update that was cut short, the old marker still says which examples nobody has changed.
    _write(folder, MARKER, Marker(labrig, new).encode())
    return written


def _list_changed(
    differing: Collection[str], found: Mapping[str, str], former: Mapping[str, str], new: Mapping[str, str]
) -> list[str]:
    """Return the files that somebody has changed and of which labrig has another version than it had."""
    return [
        place
        for place in differing
        if place not in SCHEMAS and found[place] != former.get(place) and new[place] != former.get(place)
    ]


def suggest_update(folder: Path) -> str:
    """Return the command that brings a lab folder up to date."""
    return "labrig init --update" + ("" if folder == Path() else f" {shlex.quote(str(folder))}")


def _name(folder: Path) -> str:
    return "this folder" if folder == Path() else str(folder)


def _read_usable_marker(folder: Path, labrig: str) -> Marker | None:
    """Return the marker. Raises `InputError` if it is damaged, or of a newer labrig."""
    marker = read_marker(folder)
    if marker is not None and marker.is_newer_than(labrig):
        why, remedy = marker.explain_newer(labrig)
        raise InputError(f"{_name(folder)} was made {why}", f"{remedy}; nothing was changed")
    return marker


def _write_all(folder: Path, files: Mapping[str, bytes], places: Collection[str]) -> None:
    for place in places:
        _write(folder, place, files[place])
    with disk_errors(folder):
        (folder / RUNS).mkdir(parents=True, exist_ok=True)


def _write(folder: Path, place: str, content: bytes) -> None:
    path = folder / place
    with disk_errors(path):
        path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, content)


def _read(path: Path) -> bytes:
    with disk_errors(path):
        return read_file(path)
