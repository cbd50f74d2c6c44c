"""The files that a run has before anything moves: protocol, rig, calibration and the opening manifest."""

import os
from collections.abc import Callable, Mapping
from contextlib import suppress
from datetime import datetime
from itertools import count
from pathlib import Path
from typing import TypeVar

from labrig.durable import disk_errors, open_descriptor, write_and_rename
from labrig.errors import InputError, OutputExistsError
from labrig.input_file import read_file
from labrig.posix import reserve, sync_directory
from labrig.record.json_lines import checksum, encode_document
from labrig.record.layout import (
    CALIBRATION,
    CODE_DIFF,
    FRAMES,
    PROTOCOL,
    RESERVE,
    RIG,
    SCHEMA_VERSION,
    require_name,
)

_RESERVE_BYTES = 2**20

_Created = TypeVar("_Created")


def collect_opening_files(
    protocol_yaml: str,
    rig_yaml: str | None,
    calibration_files: Mapping[str, Path | bytes],
    code_diff: bytes,
) -> dict[str, bytes]:
    """Return the files that the run begins with: name relative to the run, content."""
    rig = {} if rig_yaml is None else {RIG: rig_yaml.encode()}
    diff = {CODE_DIFF: code_diff} if code_diff else {}
    calibration = {
        f"{CALIBRATION}/{require_name(name, 'the calibration file name')}": _read_source(source)
        for name, source in calibration_files.items()
    }
    return {PROTOCOL: protocol_yaml.encode(), **rig, **diff, **calibration}


def _read_source(source: Path | bytes) -> bytes:
    if isinstance(source, bytes):
        return source
    try:
        return read_file(source)
    except OSError as error:
        raise InputError(
            f"cannot read the calibration file {source}: {error.strerror}", "check the rig file"
        ) from error


def make_opening_manifest(
    run_name: str,
    given: Mapping[str, object],
    sums: Mapping[str, str],
    recording: Mapping[str, object],
    first_link_sha256: str,
) -> dict[str, object]:
    """Return the manifest that a run begins with; one that lacks what a list of runs needs is refused."""
    missing = [key for key in ("experiment", "started") if not given.get(key)]
    if missing:
        raise InputError(f"the manifest of {run_name} lacks {' and '.join(missing)}")
    calibration = {
        name.removeprefix(f"{CALIBRATION}/"): sums[name]
        for name in sums
        if name.startswith(f"{CALIBRATION}/")
    }
    hashes = {
        "protocol_sha256": sums[PROTOCOL],
        "rig_sha256": sums.get(RIG),
        "code_diff_sha256": sums.get(CODE_DIFF),
        "calibration": calibration,
        "first_link_sha256": first_link_sha256,
    }
    # In the order of the file.
    defaults = {
        "schema_version": SCHEMA_VERSION,
        "run": run_name,
        "experiment": None,
        "title": "",
        "exit_status": "incomplete",
        "reason": None,
        "started": None,
        "ended": None,
        "trials_planned": None,
        "trials_done": 0,
        "seed": None,
        "operator": None,
        "hashes": hashes,
        "recording": recording,
        "provenance": {},
        "devices": {},
    }
    return defaults | dict(given) | {key: defaults[key] for key in _OWN_KEYS}


# Only the recorder knows these.
_OWN_KEYS = ("schema_version", "run", "exit_status", "reason", "ended", "trials_done", "hashes", "recording")


def make_run_directory(path: Path) -> None:
    """Make the folder of a run; an existing one is refused and left alone."""
    with disk_errors(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            path.mkdir()
        except FileExistsError as error:
            raise _make_name_error(path) from error


def require_free_name(runs_dir: Path, run_name: str) -> None:
    """Refuse the name of a run that exists already, before any work. Raises `OutputExistsError`, `InputError`."""
    path = runs_dir / require_name(run_name, "the run name")
    if path.exists():
        raise _make_name_error(path)


def _make_name_error(path: Path) -> OutputExistsError:
    return OutputExistsError(f"{path} exists already", "give the run another name")


def create_under_free_name(started: datetime, what: str, create: Callable[[str], _Created]) -> _Created:
    """Create a run under the first name that is free: TIME-WHAT, TIME-WHAT-2 ...

    A name belongs to whoever makes its folder, so runs that start in the same second get different names.

    Parameters
    ----------
    create : callable
        Creates a run of a name. Its `OutputExistsError` has the next name tried; other errors are raised.
    """
    name = f"{started:%Y%m%d-%H%M%S}-{what}"
    for number in count(1):
        with suppress(OutputExistsError):
            return create(name if number == 1 else f"{name}-{number}")
    raise AssertionError("count() has no end")


def write_opening_files(path: Path, texts: Mapping[str, bytes]) -> None:
    """Write what is known before anything moves, except the manifest."""
    (path / FRAMES).mkdir()
    (path / CALIBRATION).mkdir()
    for name, content in texts.items():
        write_and_rename(path / name, content)
    sync_directory(path / CALIBRATION)
    make_reserve(path)


def make_reserve(path: Path) -> None:
    """Reserve disk space for the end of the run.

    When the disk is full, it still holds the last lines, SHA256SUMS (83 bytes a picture) and the manifest, so that the
    record states that the run failed and why.
    """
    with open_descriptor(path / RESERVE, os.O_WRONLY | os.O_CREAT | os.O_EXCL) as descriptor:
        reserve(descriptor, _RESERVE_BYTES)


def encode_manifest(manifest: Mapping[str, object]) -> bytes:
    """Encode a manifest with its checksum."""
    return encode_document({**manifest, "crc32": checksum(manifest)})
