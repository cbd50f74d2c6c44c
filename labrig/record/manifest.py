"""The manifest of a run, and SHA256SUMS beside it.

SHA256SUMS covers what the run begins with from its start, and everything that was recorded, the manifest too, from its
end. `sha256sum -c SHA256SUMS` in the folder of a run, or of one of its results, verifies it without labrig.
"""

import re
import shlex
from collections.abc import Iterator, Mapping
from pathlib import Path

from labrig.errors import Problem, RecordError
from labrig.input_file import MAX_LOG_BYTES, parse_json, read_file
from labrig.record.json_lines import encode_line
from labrig.record.layout import (
    CALIBRATION,
    COPY_HINT,
    MANIFEST,
    PROTOCOL,
    RIG,
    SCHEMA_VERSION,
    SHA256SUMS,
    hash_file,
    inside,
)

INCOMPLETE = "incomplete"
"""`exit_status` of a run that has not ended."""

_CODE_DIFF = re.compile(r"code(\.\d{3,})?\.diff")
_SUM = re.compile(r"([0-9a-f]{64})  (\S.*)")


def read_manifest(run: Path) -> dict[str, object]:
    """Read the manifest of a run.

    Raises
    ------
    RecordError
        When `run` is no run, or its manifest is damaged or has another schema.
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
        raise RecordError(f"{path} is damaged: {error}", COPY_HINT) from error
    if not isinstance(manifest, dict) or not isinstance(manifest.get("exit_status"), str):
        raise RecordError(f"{path} is damaged: it is no manifest of a run", COPY_HINT)
    if manifest.get("schema_version") != SCHEMA_VERSION:
        raise RecordError(
            f"{path} has schema version {manifest.get('schema_version')!r}; this labrig reads {SCHEMA_VERSION}",
            "read it with the labrig that wrote it",
        )
    return manifest


def encode_manifest(manifest: Mapping[str, object]) -> bytes:
    """Encode a manifest: a member a line, each compact, so that a list of runs reads little."""
    members = (encode_line({key: value}).decode().strip()[1:-1] for key, value in manifest.items())
    return ("{" + ",\n".join(members) + "}\n").encode()


def has_ended(manifest: Mapping[str, object]) -> bool:
    """Return whether a run has ended, so that SHA256SUMS covers all of it."""
    return manifest["exit_status"] != INCOMPLETE


def read_sums(folder: Path) -> tuple[dict[str, str], tuple[int, ...]]:
    """Return the SHA-256 of each file by its name, and the numbers of the lines that are no checksum.

    Raises
    ------
    RecordError
        When SHA256SUMS cannot be read.
    """
    path = inside(folder, SHA256SUMS)
    try:
        # Not by `splitlines`, which takes other bytes for ends of lines too: a changed one would go unnoticed.
        *lines, rest = read_file(path, MAX_LOG_BYTES).decode(errors="replace").split("\n")
    except OSError as error:
        raise RecordError(f"cannot read {path}: {error.strerror}", COPY_HINT) from error
    lines += [rest] if rest else []
    found = [(number, _SUM.fullmatch(line)) for number, line in enumerate(lines, start=1)]
    wrong = tuple(number for number, match in found if match is None or not _is_inner(match[2]))
    return {match[2]: match[1] for _, match in found if match is not None and _is_inner(match[2])}, wrong


def check_file(folder: Path, name: str, sha256: str, by: str) -> Iterator[Problem]:
    """Yield why a file is not what was recorded; without a SHA-256 only whether it is there."""
    try:
        path = inside(folder, name)
        if not path.is_file():
            yield Problem(name, f"it is missing, though {by} lists it", COPY_HINT)
        elif sha256 and hash_file(path) != sha256:
            yield Problem(name, f"it does not fit {by}: one of the two was changed", COPY_HINT)
    except RecordError as error:
        yield Problem(name, error.message, error.hint)


def read_checksum(run: Path) -> str | None:
    """Return the SHA-256 of SHA256SUMS, which stands for a whole record; None of a run that has not ended."""
    try:
        return hash_file(inside(run, SHA256SUMS)) if has_ended(read_manifest(run)) else None
    except RecordError:  # whoever reads it says so
        return None


def encode_sums(sums: Mapping[str, str]) -> bytes:
    """Encode SHA256SUMS."""
    return "".join(f"{sums[name]}  {name}\n" for name in sorted(sums)).encode()


def _is_inner(name: str) -> bool:
    """Return whether a name leads to no place outside of its folder."""
    return all(part not in {"", ".", ".."} for part in name.split("/"))


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
