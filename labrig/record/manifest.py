"""Read and check the manifest of a run."""

import re
import shlex
from collections.abc import Iterator, Mapping
from pathlib import Path

from labrig.errors import Problem, RecordError
from labrig.input_file import parse_json, read_file
from labrig.record.json_lines import checksum
from labrig.record.layout import (
    CALIBRATION,
    CODE_DIFF,
    COPY_HINT,
    MANIFEST,
    PROTOCOL,
    RIG,
    SCHEMA_VERSION,
    inside,
)

DAMAGED_WHEN_CLOSED = "damaged_when_closed"
"""Key in the manifest of a run that was damaged when it was closed: what was damaged, `where: what` each."""

_SESSION_DIFF = re.compile(r"code\.\d{3,}\.diff")


def read_manifest(run: Path) -> dict[str, object]:
    """Read the manifest of a run, its checksum included.

    Raises
    ------
    RecordError
        When `run` is no run, or its manifest is damaged or has a newer schema.
    """
    manifest = read_document(run)
    if is_newer(manifest):
        raise RecordError(
            f"{run / MANIFEST} has schema version {manifest['schema_version']}; "
            f"this labrig reads up to {SCHEMA_VERSION}",
            "read it with a newer labrig",
        )
    return manifest


def read_document(run: Path) -> dict[str, object]:
    """Read the manifest of a run of any schema, even a newer one.

    Raises
    ------
    RecordError
        When `run` is no run, or its manifest is damaged.
    """
    if run.is_symlink():
        raise RecordError(f"{run} is a symbolic link and is not followed", "give the folder itself")
    path = inside(run, MANIFEST)
    try:
        manifest = parse_json(read_file(path))
    except OSError as error:
        raise RecordError(
            f"{run} is no run: cannot read {MANIFEST}: {error.strerror}",
            "give the folder of a run; labrig runs lists them",
        ) from error
    except ValueError as error:
        raise RecordError(f"{path} is damaged: {error}", _HINT) from error
    if not isinstance(manifest, dict):
        raise RecordError(f"{path} is damaged: it holds no JSON object", _HINT)
    version = manifest.get("schema_version")
    if not isinstance(version, int) or version < 1:
        raise RecordError(f"{path} is damaged: schema_version is {version!r}", _HINT)
    return manifest


def is_newer(manifest: Mapping[str, object]) -> bool:
    """Return whether a manifest has a schema that this labrig does not know."""
    version = manifest["schema_version"]
    return isinstance(version, int) and version > SCHEMA_VERSION


def find_rig_option(manifest: Mapping[str, object]) -> str:
    """Return the option that names the rig file of a run in a command; `--rig FILE` as it stands if none is kept."""
    sources = manifest.get("sources")
    rig = sources.get("rig") if isinstance(sources, Mapping) else None
    return f"--rig {shlex.quote(rig) if isinstance(rig, str) else 'FILE'}"


def check_manifest(manifest: dict[str, object]) -> tuple[Problem, ...]:
    """Return a problem if the checksum of a manifest does not fit its content, and what was damaged on closing."""
    content = {key: value for key, value in manifest.items() if key != "crc32"}
    marks = manifest.get(DAMAGED_WHEN_CLOSED)
    marked = tuple(
        Problem(MANIFEST, f"it says that the run was damaged when labrig closed it: {mark}", COPY_HINT)
        for mark in (marks if isinstance(marks, list) else ())
    )
    if manifest.get("crc32") == checksum(content):
        return marked
    message = "its CRC-32 does not fit its content: it was changed after labrig wrote it"
    return (Problem(MANIFEST, message, _HINT), *marked)


def is_simulated(manifest: Mapping[str, object]) -> bool:
    """Return whether a run was made on a simulated rig, which has new gel whenever it is opened."""
    devices = manifest.get("devices")
    return isinstance(devices, Mapping) and devices.get("kind") == "simulated"


def calibration_sha256(manifest: Mapping[str, object]) -> dict[str, object]:
    """Return the SHA-256 of each calibration file that the run began with, by its name."""
    hashes = manifest.get("hashes")
    files = hashes.get("calibration") if isinstance(hashes, Mapping) else None
    return {str(name): sha256 for name, sha256 in files.items()} if isinstance(files, Mapping) else {}


def recorded_sha256(manifest: dict[str, object]) -> dict[str, object]:
    """Return the SHA-256 of each file that the run or a later session began with, by its name in the run."""
    hashes = manifest.get("hashes")
    if not isinstance(hashes, dict):
        return {}
    sometimes = {RIG: hashes.get("rig_sha256"), CODE_DIFF: hashes.get("code_diff_sha256")}
    return {
        PROTOCOL: hashes.get("protocol_sha256"),
        **{name: sha256 for name, sha256 in sometimes.items() if sha256 is not None},
        **{f"{CALIBRATION}/{name}": sha256 for name, sha256 in calibration_sha256(manifest).items()},
        **dict(_list_session_diffs(manifest)),
    }


def _list_session_diffs(manifest: Mapping[str, object]) -> Iterator[tuple[str, object]]:
    """Yield the file with the code differences of each later session that has one, and its SHA-256."""
    sessions = manifest.get("sessions")
    for session in sessions if isinstance(sessions, list) else ():
        name = session.get("code_diff") if isinstance(session, Mapping) else None
        if isinstance(name, str) and _SESSION_DIFF.fullmatch(name):
            yield name, session.get("code_diff_sha256")


_HINT = "take the file from a copy of the run; labrig repairs no manifest"
