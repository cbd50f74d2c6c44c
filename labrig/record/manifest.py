"""Reads the manifest of a run, and says what is wrong with it."""

import json
from pathlib import Path

from labrig.errors import Problem, RecordError
from labrig.record.json_lines import checksum
from labrig.record.layout import CALIBRATION, MANIFEST, PROTOCOL, RIG, SCHEMA_VERSION, inside


def read_manifest(run: Path) -> dict[str, object]:
    """Read the manifest of a run, its checksum included.

    Raises
    ------
    RecordError
        When `run` is no run, or its manifest is damaged or of a newer schema.
    """
    path = inside(run, MANIFEST)
    try:
        manifest = json.loads(path.read_bytes())
    except OSError as error:
        raise RecordError(
            f"{run} is no run: cannot read {MANIFEST}: {error.strerror}",
            "give the folder of a run; labrig runs lists them",
        ) from error
    except ValueError as error:
        raise RecordError(f"{path} is damaged: {error}", _HINT) from error
    if not isinstance(manifest, dict):
        raise RecordError(f"{path} is damaged: it holds no JSON object", _HINT)
    _require_known_schema(path, manifest.get("schema_version"))
    return manifest


def manifest_problems(manifest: dict[str, object]) -> tuple[Problem, ...]:
    """Return what the checksum of a manifest that could be read says of its content."""
    content = {key: value for key, value in manifest.items() if key != "crc32"}
    if manifest.get("crc32") == checksum(content):
        return ()
    return (
        Problem(MANIFEST, "its CRC-32 does not fit its content: it was changed after labrig wrote it", _HINT),
    )


def recorded_sha256(manifest: dict[str, object]) -> dict[str, object]:
    """Return the SHA-256 of each file that the run began with, by its name relative to the run."""
    hashes = manifest.get("hashes")
    if not isinstance(hashes, dict):
        return {}
    calibration = hashes.get("calibration")
    files = calibration.items() if isinstance(calibration, dict) else ()
    rig = hashes.get("rig_sha256")
    return {
        PROTOCOL: hashes.get("protocol_sha256"),
        **({} if rig is None else {RIG: rig}),
        **{f"{CALIBRATION}/{name}": sha256 for name, sha256 in files},
    }


def _require_known_schema(path: Path, version: object) -> None:
    if not isinstance(version, int) or version < 1:
        raise RecordError(f"{path} is damaged: schema_version is {version!r}", _HINT)
    if version > SCHEMA_VERSION:
        raise RecordError(
            f"{path} has schema version {version}; this labrig reads up to {SCHEMA_VERSION}",
            "read it with a newer labrig",
        )


_HINT = "take the file from a copy of the run; labrig repairs no manifest"
