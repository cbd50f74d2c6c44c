"""Calibrations on disk: JSON with all digits, the kind of file, its provenance and its evidence.

A plane file identifies its lens by a fingerprint: a map that was fitted with one lens and used with another is wrong
by an amount that no later check can notice.
"""

import json
from collections.abc import Mapping
from contextlib import suppress
from datetime import datetime
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from pydantic import TypeAdapter, ValidationError

from labrig.durable import write_atomically
from labrig.errors import FileFormatError, InputError, Problem
from labrig.input_file import parse_json, read_file
from labrig.vision.camera_frame import CAMERA, CameraInUse
from labrig.vision.intrinsics import LENS, Intrinsics
from labrig.vision.plane import PlaneMap

_INTRINSICS = "labrig-intrinsics"
_PLANE = "labrig-plane"
_SCHEMA_VERSION = 1
_MADE_BY = {_INTRINSICS: "`labrig calibrate intrinsics`", _PLANE: "`labrig calibrate plane`"}


class _PlaneDocument(PlaneMap):
    """A plane map as its file holds it."""

    intrinsics_sha256: str | None


_PLANE_DOCUMENT = TypeAdapter(_PlaneDocument)
_Document = TypeVar("_Document")


def save_intrinsics(path: Path, intrinsics: Intrinsics, provenance: Mapping[str, Any]) -> None:
    """Write a lens calibration with its provenance, a mapping of JSON values.

    Raises
    ------
    DiskError
        If the file cannot be written; a previous file is then unchanged.
    """
    _save(path, _INTRINSICS, intrinsics.to_json(), provenance)


def load_intrinsics(path: Path) -> Intrinsics:
    """Read a lens calibration, accepted or not.

    Raises
    ------
    FileFormatError
        If the file is missing, not JSON, of another kind, newer than this program, or lacks a value.
    """
    return _load(path, _INTRINSICS, LENS)


def save_plane(path: Path, plane: PlaneMap, provenance: Mapping[str, Any]) -> None:
    """Write a plane map with its provenance, a mapping of JSON values.

    Raises
    ------
    DiskError
        If the file cannot be written; a previous file is then unchanged.
    """
    fingerprint = None if plane.intrinsics is None else plane.intrinsics.fingerprint()
    _save(path, _PLANE, {**plane.to_json(), "intrinsics_sha256": fingerprint}, provenance)


def load_plane(path: Path, intrinsics: Intrinsics | None) -> PlaneMap:
    """Read a plane map that was made with `intrinsics`, accepted or not.

    Raises
    ------
    FileFormatError
        If the file is missing, not JSON, of another kind, newer than this program, or lacks a value.
    InputError
        If the lens calibration with which the map was made is not `intrinsics`.
    """
    found = _load(path, _PLANE, _PLANE_DOCUMENT)
    given = None if intrinsics is None else intrinsics.fingerprint()
    if found.intrinsics_sha256 != given:
        raise InputError(
            f"{path} was made with {_name_lens(found.intrinsics_sha256)}, not with {_name_lens(given)}",
            "give the intrinsics that it was made with, or make it again with these",
        )
    if not np.linalg.det(found.matrix):
        raise FileFormatError((Problem(f"{path} homography", "has no inverse", _remake_hint(_PLANE)),))
    values = {name: getattr(found, name) for name in PlaneMap.model_fields}
    return PlaneMap(**{**values, "intrinsics": intrinsics})


def load_px_per_mm(path: Path) -> float:
    """Return the scale of a plane map at its origin, whose lens need not be at hand.

    Raises
    ------
    FileFormatError
        As `load_plane`.
    """
    return 1.0 / _load(path, _PLANE, _PLANE_DOCUMENT).mm_per_px


def read_creation_time(path: Path) -> datetime | None:
    """Return when a calibration was made, from its provenance; None if that is unknown."""
    with suppress(ValueError, KeyError, TypeError):
        document: Any = parse_json(_read(path))
        created = datetime.fromisoformat(document["provenance"]["created"])
        return created if created.tzinfo else None
    return None


def read_camera(path: Path) -> CameraInUse | None:
    """Return the camera with which a calibration was made, from its provenance; None if it is unknown."""
    with suppress(ValueError, KeyError, TypeError):
        document: Any = parse_json(_read(path))
        return CameraInUse.parse(document["provenance"][CAMERA])
    return None


def _name_lens(fingerprint: str | None) -> str:
    return "no intrinsics" if fingerprint is None else f"the intrinsics {fingerprint[:12]}"


def _remake_hint(kind: str) -> str:
    return f"write it again with {_MADE_BY[kind]}"


def _save(path: Path, kind: str, values: dict[str, Any], provenance: Mapping[str, Any]) -> None:
    document = {"kind": kind, "schema_version": _SCHEMA_VERSION, **values, "provenance": dict(provenance)}
    write_atomically(path, to_json_text(document).encode())


def to_json_text(document: Mapping[str, Any]) -> str:
    """Return a document as the JSON text of a file."""
    return json.dumps(document, indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def _load(path: Path, kind: str, documents: TypeAdapter[_Document]) -> _Document:
    content = _read(path)
    try:
        document = parse_json(content, finite=False)
    except json.JSONDecodeError as error:
        problem = Problem(
            f"{path}:{error.lineno}:{error.colno}", f"is not JSON: {error.msg}", _remake_hint(kind)
        )
        raise FileFormatError((problem,)) from error
    except ValueError as error:
        raise FileFormatError((Problem(str(path), f"is not JSON: {error}", _remake_hint(kind)),)) from error
    _check_kind(path, kind, document)
    try:
        return documents.validate_json(content)
    except ValidationError as error:
        problems = tuple(
            Problem(f"{path} {'.'.join(map(str, fault['loc']))}", fault["msg"], _remake_hint(kind))
            for fault in error.errors()
        )
        raise FileFormatError(problems) from error


def _read(path: Path) -> bytes:
    try:
        content = read_file(path)
        content.decode("utf-8")
        return content
    except (OSError, UnicodeDecodeError) as error:
        if isinstance(error, FileNotFoundError):
            fault = "does not exist"
        else:
            fault = f"cannot be read: {error.strerror}" if isinstance(error, OSError) else "is not text"
        raise FileFormatError((Problem(str(path), fault, "check the path"),)) from error


def _check_kind(path: Path, kind: str, document: object) -> None:
    keys = document if isinstance(document, dict) else {}
    found, version = keys.get("kind"), keys.get("schema_version")
    if found != kind:
        fault, hint = f"is {found!r}, not {kind!r}", f"give a file that {_MADE_BY[kind]} wrote"
        raise FileFormatError((Problem(f"{path} kind", fault, hint),))
    if version != _SCHEMA_VERSION:
        fault = f"is {version!r}, this labrig reads {_SCHEMA_VERSION}"
        hint = "read it with the labrig that wrote it, or calibrate again"
        raise FileFormatError((Problem(f"{path} schema_version", fault, hint),))
