"""The files of a run: their names, the manifest, and SHA256SUMS.

SHA256SUMS covers what the run begins with from its start, and everything that was recorded, the manifest too, from its
end. `sha256sum -c SHA256SUMS` in the folder of a run, or of one of its results, verifies it without labrig.
"""

import hashlib
import os
import re
import shlex
from collections.abc import Container, Iterator, Mapping
from pathlib import Path
from typing import Any

from labrig.errors import InputError, Problem, RecordError
from labrig.input_file import MAX_DOCUMENT_BYTES, MAX_LOG_BYTES, open_file, parse_json, read_file

SCHEMA_VERSION = 1
COPY_HINT = "take the file from a copy of the run"

MANIFEST = "manifest.json"
PROTOCOL = "protocol.yaml"
RIG = "rig.yaml"
CODE_DIFF = "code.diff"
CALIBRATION = "calibration"
FRAMES = "frames"
SHA256SUMS = "SHA256SUMS"
ANALYSIS = "analysis"
REPORT, VIEW = "report.html", "view.rrd"

FRAME_LINES = "frames.jsonl"
STATE_LINES = "states.jsonl"
EVENT_LINES = "events.jsonl"
TRUTH_LINES = "truth.jsonl"
DEVICE_LINES = "devices.jsonl"
"""What the devices said of themselves when a session began and when it ended."""
ALWAYS_PRESENT = (FRAME_LINES, STATE_LINES, EVENT_LINES)
SEQUENCED = frozenset({FRAME_LINES, STATE_LINES, EVENT_LINES, TRUTH_LINES})
"""Files whose lines say their place in the order of all lines, `seq`: what was asked and answered, in order."""
CAN_LOG = "can.log"
NOTES = "notes.json"
LOCK = ".lock"
RESERVE = ".reserve"
CONTROL = ".control"
CAMPAIGN = "campaign.json"
"""In the folder of a campaign, which is no run, but is locked and takes requests as one."""

INCOMPLETE = "incomplete"
"""`exit_status` of a run that has not ended, and of a trial without a stop."""

_CODE_DIFF = re.compile(r"code(\.\d{3,})?\.diff")
_SUM = re.compile(r"([0-9a-f]{64})  (\S.*)")
# ext4, XFS and most others allow 255 bytes; the rest is for the suffix of a temporary name.
_MAX_NAME_BYTES = 200


def picture_file(frame: int, suffix: str = ".png") -> str:
    """Return the file of the picture with this number, relative to the run."""
    return f"{FRAMES}/{frame:06d}{suffix}"


def run_lock(run: Path) -> Path:
    """Return the lock file that the writer of a run holds."""
    return run / LOCK


def run_control(run: Path) -> Path:
    """Return the file in which a run takes requests while it is made. Raises `RecordError` if it is a link."""
    return inside(run, CONTROL)


def require_name(name: str, what: str) -> str:
    """Return `name` if it is valid as a file or folder name; inner blanks and non-ASCII letters are allowed.

    Raises
    ------
    InputError
        When it is empty, too long, begins with a dot, begins or ends with a blank, or holds a path separator or a
        control character.
    """
    is_plain = name.isprintable() and name == name.strip() and not name.startswith(".")
    if is_plain and not {"/", "\\"} & set(name) and 0 < len(name.encode()) <= _MAX_NAME_BYTES:
        return name
    raise InputError(
        f"{what} {name!r} is no name of a file: it has 1 to {_MAX_NAME_BYTES} bytes, no dot or blank before it, no "
        "blank behind it, and no path separator or control character",
        "choose a name of letters, digits, '-' and '_'",
    )


def inside(run: Path, relative: str) -> Path:
    """Return the path of a file of a run.

    Raises
    ------
    RecordError
        When it, or a folder on the way to it, is a symbolic link.
    """
    path = run
    for part in relative.split("/"):
        path = path / part
        if os.path.islink(path):  # noqa: PTH114 - this one takes a name that no file can have
            message = f"{path} is a symbolic link"
            raise RecordError(message, "a record holds its files itself; no link in it is followed")
    return path


WITHDRAWS = "withdraws"
"""Key in the manifest of a withdrawal: the run whose needle it withdraws."""


def hash_file(path: Path) -> str:
    """Return the SHA-256 of a file. Raises `RecordError` if it cannot be read."""
    try:
        with open_file(path) as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise RecordError(f"cannot read {path}: {error.strerror}", COPY_HINT) from error


def read_manifest(run: Path) -> dict[str, Any]:
    """Read the manifest of a run.

    Raises
    ------
    RecordError
        When `run` is no run, or its manifest is damaged or has another schema.
    """
    if run.is_symlink():
        raise RecordError(f"{run} is a symbolic link and is not followed", "give the folder itself")
    path = inside(run, MANIFEST)
    if not path.is_file():
        raise RecordError(
            f"{run} is no run: it has no {MANIFEST}", "give the folder of a run; labrig runs lists them"
        )
    manifest = read_document(path)
    if not isinstance(manifest.get("exit_status"), str):
        raise RecordError(f"{path} is damaged: it is no manifest of a run", COPY_HINT)
    if manifest.get("schema_version") != SCHEMA_VERSION:
        raise RecordError(
            f"{path} has schema version {manifest.get('schema_version')!r}; this labrig reads {SCHEMA_VERSION}",
            "read it with the labrig that wrote it",
        )
    return manifest


def read_document(path: Path, max_bytes: int = MAX_DOCUMENT_BYTES, hint: str = COPY_HINT) -> dict[str, Any]:
    """Read a file that is one JSON object. Raises `RecordError` when it cannot be read or is none."""
    try:
        document = parse_json(read_file(path, max_bytes))
    except (OSError, ValueError) as error:
        raise RecordError(f"{path} is damaged: {error}", hint) from error
    if not isinstance(document, dict):
        raise RecordError(f"{path} is damaged: it holds no JSON object", hint)
    return document


def has_ended(manifest: Mapping[str, object]) -> bool:
    """Return whether a run has ended, so that SHA256SUMS covers all of it."""
    return manifest["exit_status"] != INCOMPLETE


def read_sums(folder: Path) -> dict[str, str]:
    """Return the SHA-256 of each file by its name. Raises `RecordError` when SHA256SUMS is missing or damaged."""
    path = inside(folder, SHA256SUMS)
    try:
        content = read_file(path, MAX_LOG_BYTES).decode(errors="replace")
    except OSError as error:
        raise RecordError(f"cannot read {path}: {error.strerror}", COPY_HINT) from error
    # Not by `splitlines`, which takes other bytes for ends of lines too: a changed one would go unnoticed.
    lines = content.removesuffix("\n").split("\n") if content else []
    found = [_SUM.fullmatch(line) for line in lines]
    for number, match in enumerate(found, start=1):
        if match is None or {"", ".", ".."} & set(match[2].split("/")):
            raise RecordError(f"{path}:{number}: the line is no checksum and file name", COPY_HINT)
    return {match[2]: match[1] for match in found if match is not None}


def find_changed(folder: Path, sums: Mapping[str, str], by: str) -> Iterator[Problem]:
    """Yield the files that are missing, links, or not what `by` says; those without a SHA-256 need only be there."""
    for name, sha256 in sums.items():
        try:
            path = inside(folder, name)
            if not os.path.isfile(path):  # noqa: PTH113 - this one takes a name that no file can have
                yield Problem(name, f"it is missing, though {by} lists it", COPY_HINT)
            elif sha256 and hash_file(path) != sha256:
                yield Problem(name, f"it does not fit {by}: one of the two was changed", COPY_HINT)
        except RecordError as error:
            yield Problem(name, error.message, error.hint)


def find_added(folder: Path, known: Container[str]) -> Iterator[Problem]:
    """Yield the files that are none of the known ones; hidden files and SHA256SUMS itself are passed over."""
    for name in list_files(folder):
        if name not in known and name != SHA256SUMS:
            yield Problem(name, "it is no part of the record and is not used", "move it out of the run")


def list_files(folder: Path) -> list[str]:
    """Return the names of the files in a folder and below it, in order, without hidden ones."""
    names = [path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()]
    return sorted(name for name in names if "/." not in f"/{name}")


def read_checksum(run: Path) -> str | None:
    """Return the SHA-256 of SHA256SUMS, which stands for a whole record; None of a run that has not ended."""
    try:
        return hash_file(inside(run, SHA256SUMS)) if has_ended(read_manifest(run)) else None
    except RecordError:  # whoever reads it says so
        return None


def encode_sums(sums: Mapping[str, str]) -> bytes:
    """Encode SHA256SUMS."""
    return "".join(f"{sums[name]}  {name}\n" for name in sorted(sums)).encode()


def is_opening_file(name: str) -> bool:
    """Return whether a session begins with this file: protocol, rig, calibration, changes of the code."""
    return (
        name in {PROTOCOL, RIG}
        or name.startswith(f"{CALIBRATION}/")
        or _CODE_DIFF.fullmatch(name) is not None
    )


def find_rig_option(manifest: Mapping[str, object]) -> str:
    """Return the option that names the rig file of a run in a command; `--rig FILE` as it stands if none is kept."""
    sources = manifest.get("sources")
    rig = sources.get("rig") if isinstance(sources, Mapping) else None
    return f"--rig {shlex.quote(rig) if isinstance(rig, str) else 'FILE'}"


def is_simulated(manifest: Mapping[str, object]) -> bool:
    """Return whether a run was made on a simulated rig, which has new gel whenever it is opened."""
    rig = manifest.get("rig")
    return isinstance(rig, Mapping) and rig.get("kind") == "simulated"
