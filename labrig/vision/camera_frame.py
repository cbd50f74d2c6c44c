"""Test frames of a camera: PNG files that carry the camera and its settings, for the calibration that is made of them.

The settings are JSON in a text chunk (PNG specification, third edition, section 11.3.3), which viewers pass over.
"""

import json
import struct
import zlib
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

import cv2

from labrig.input_file import parse_json, read_file
from labrig.vision.camera_in_use import CameraInUse
from labrig.vision.picture import MAX_PICTURE_BYTES, PNG_SIGNATURE, Picture, list_png_chunks

_TEXT, _KEYWORD = b"tEXt", b"labrig camera"
_HEADER_BYTES = len(PNG_SIGNATURE) + 25
"""Where the next chunk goes: behind the signature and the header, IHDR, of 25 bytes."""


def encode_frame(image: Picture, camera: CameraInUse) -> bytes:
    """Return the content of a PNG file with a picture and its camera."""
    png = cv2.imencode(".png", image)[1].tobytes()
    body = _KEYWORD + b"\0" + json.dumps(camera.model_dump()).encode("ascii")
    chunk = (
        struct.pack(">I", len(body)) + _TEXT + body + struct.pack(">I", zlib.crc32(body, zlib.crc32(_TEXT)))
    )
    return png[:_HEADER_BYTES] + chunk + png[_HEADER_BYTES:]


def read_common_camera(paths: Sequence[Path]) -> CameraInUse | None:
    """Return the camera that all these files carry; None if one carries none or another."""
    cameras = [_read_camera(path) for path in paths]
    return cameras[0] if cameras and all(camera == cameras[0] for camera in cameras) else None


def _read_camera(path: Path) -> CameraInUse | None:
    content = read_file(path, MAX_PICTURE_BYTES) if path.is_file() else b""
    if not content.startswith(PNG_SIGNATURE):
        return None
    for kind, body, checksum in list_png_chunks(content):
        keyword, _, text = body.partition(b"\0")
        if kind == _TEXT and keyword == _KEYWORD and zlib.crc32(body, zlib.crc32(kind)) == checksum:
            with suppress(ValueError):
                return CameraInUse.parse(parse_json(text))
    return None
