"""Calibrations on disk: JSON with all digits, the kind of file, its provenance and its evidence.

A plane file identifies its lens by a fingerprint: a map that was fitted with one lens and used with another is wrong
by an amount that no later check can notice. The provenance has the camera and its settings. Test frames are PNG files
that carry the camera as JSON in a text chunk, for the calibration that is made of them.
"""

import json
from collections.abc import Mapping, Sequence
from contextlib import suppress
from datetime import datetime
from io import BytesIO
from pathlib import Path
from typing import Any, Literal, TypeVar

import cv2
import numpy as np
from PIL import Image
from PIL.PngImagePlugin import PngInfo
from pydantic import BaseModel, ConfigDict, TypeAdapter, ValidationError

from labrig.durable import write_atomically
from labrig.errors import FileFormatError, InputError, Problem
from labrig.input_file import parse_json, read_file
from labrig.vision.intrinsics import LENS, Intrinsics
from labrig.vision.picture import MAX_PICTURE_BYTES, Picture
from labrig.vision.plane import PlaneMap

CAMERA = "camera"
"""Its key in the provenance of a calibration."""
_KEYWORD = "labrig camera"


class CameraInUse(BaseModel):
    """A camera and its settings.

    Attributes
    ----------
    driver, device : str or None
        Its driver and its address, as the rig file has them.
    settings : dict
        Every setting that the camera read back or reported.
    """

    model_config = ConfigDict(frozen=True, extra="ignore", allow_inf_nan=False)

    driver: str | None = None
    device: str | None = None
    settings: dict[str, str | int | float]

    @classmethod
    def parse(cls, document: Any) -> "CameraInUse | None":
        """Return the camera of a document; None if it describes none."""
        try:
            return cls.model_validate(document)
        except ValidationError:
            return None


UNKNOWN_CAMERA = CameraInUse(settings={})
"""A camera of which nothing is known."""


class _Kind(BaseModel):
    """What every calibration file says of itself."""

    kind: str
    schema_version: Literal[1]


class _PlaneDocument(PlaneMap):
    """A plane map as its file holds it."""

    intrinsics_sha256: str | None


_PLANE_DOCUMENT = TypeAdapter(_PlaneDocument)
_INTRINSICS, _PLANE = "labrig-intrinsics", "labrig-plane"
_MADE_BY = {_INTRINSICS: "`labrig calibrate intrinsics`", _PLANE: "`labrig calibrate plane`"}
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
    with suppress(ValueError, TypeError):
        created = datetime.fromisoformat(_read_provenance(path).get("created", ""))
        return created if created.tzinfo else None
    return None


def read_camera(path: Path) -> CameraInUse | None:
    """Return the camera with which a calibration was made, from its provenance; None if it is unknown."""
    return CameraInUse.parse(_read_provenance(path).get(CAMERA))


def _read_provenance(path: Path) -> dict[str, Any]:
    with suppress(ValueError, KeyError, TypeError):
        document: Any = parse_json(_read(path))
        return dict(document["provenance"])
    return {}


def _name_lens(fingerprint: str | None) -> str:
    return "no intrinsics" if fingerprint is None else f"the intrinsics {fingerprint[:12]}"


def _remake_hint(kind: str) -> str:
    return f"write it again with {_MADE_BY[kind]}"


def _save(path: Path, kind: str, values: dict[str, Any], provenance: Mapping[str, Any]) -> None:
    document = {"kind": kind, "schema_version": 1, **values, "provenance": dict(provenance)}
    write_atomically(path, to_json_text(document).encode())


def to_json_text(document: Mapping[str, Any]) -> str:
    """Return a document as the JSON text of a file."""
    return json.dumps(document, indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def _load(path: Path, kind: str, documents: TypeAdapter[_Document]) -> _Document:
    again = _remake_hint(kind)
    found = validate_file(path, TypeAdapter(_Kind), again).kind
    if found != kind:
        problem = Problem(
            f"{path} kind", f"is {found!r}, not {kind!r}", f"give a file that {_MADE_BY[kind]} wrote"
        )
        raise FileFormatError((problem,))
    return validate_file(path, documents, again)


def validate_file(path: Path, documents: TypeAdapter[_Document], again: str) -> _Document:
    """Return the document in a JSON file; `again` says in messages how to make it.

    Raises
    ------
    FileFormatError
        If the file is missing, cannot be read, is not JSON, or lacks a value.
    """
    try:
        return documents.validate_json(_read(path))
    except ValidationError as error:
        problems = tuple(
            Problem(" ".join((str(path), ".".join(map(str, fault["loc"])))).strip(), fault["msg"], again)
            for fault in error.errors()
        )
        raise FileFormatError(problems) from error


def _read(path: Path) -> bytes:
    try:
        return read_file(path)
    except OSError as error:
        problem = Problem(str(path), f"cannot be read: {error.strerror}", "see: labrig manual calibrate")
        raise FileFormatError((problem,)) from error


def encode_frame(image: Picture, camera: CameraInUse) -> bytes:
    """Return the content of a PNG file with a picture and its camera."""
    text, content = PngInfo(), BytesIO()
    text.add_text(_KEYWORD, json.dumps(camera.model_dump()))
    shown = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2RGB)
    Image.fromarray(shown).save(content, "PNG", pnginfo=text, compress_level=1)
    return content.getvalue()


def read_common_camera(paths: Sequence[Path]) -> CameraInUse | None:
    """Return the camera that all these files carry; None if one carries none or another."""
    cameras = [_read_camera(path) for path in paths]
    return cameras[0] if cameras and all(camera == cameras[0] for camera in cameras) else None


def _read_camera(path: Path) -> CameraInUse | None:
    content = read_file(path, MAX_PICTURE_BYTES) if path.is_file() else b""
    with suppress(OSError, SyntaxError, ValueError), Image.open(BytesIO(content), formats=("PNG",)) as frame:
        return (
            CameraInUse.parse(parse_json(str(frame.info[_KEYWORD]).encode()))
            if _KEYWORD in frame.info
            else None
        )
    return None
