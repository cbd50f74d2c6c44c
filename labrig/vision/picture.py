"""Pictures from files: the only place where labrig reads a picture, and what it refuses.

A picture is a uint8 array, (H, W) grey or (H, W, 3) blue-green-red, of the sensor's own pixels. A picture whose EXIF
orientation is not upright is refused: viewers turn or mirror it, so a pixel or a direction that a person reads in a
viewer is not the one that is measured. An alpha channel is dropped. Other depths are refused rather than scaled,
because a guessed scale changes the measurement.
"""

import re
import struct
import zlib
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from labrig.errors import MeasurementRefusedError, PictureError
from labrig.input_file import read_file

Picture = NDArray[np.uint8]

PICTURE_SUFFIXES = frozenset({".bmp", ".jpeg", ".jpg", ".png", ".tif", ".tiff"})
"""Suffixes of picture files."""

MAX_PICTURE_BYTES = 2**28
MAX_PIXELS = 2**26
"""The largest picture that is decoded: 8192 x 8192 pixels."""

_JPEG = b"\xff\xd8\xff"
_JPEG_START_OF_SCAN = 0xDA
_JPEG_FRAMES = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
_BMP = b"BM"
PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_PNG_EXIF, _PNG_END = b"eXIf", b"IEND"
# Least range of grey levels of a picture that shows something.
_LEAST_RANGE = 8
_CONVERT = "save it as an 8-bit PNG or JPEG"
_JPEG_APP1 = 0xE1
_TIFF_LONG = 4
_EXIF = b"Exif\x00\x00"
_WIDTH_TAG, _HEIGHT_TAG, _ORIENTATION_TAG, _UPRIGHT = 0x0100, 0x0101, 0x0112, 1
# How viewers show a picture, by the value of the tag (CIPA DC-008, 4.6.5.1).
_SHOWN = {
    2: "mirrored",
    3: "turned by 180 degrees",
    4: "mirrored and turned by 180 degrees",
    5: "mirrored and turned by 90 degrees to the left",
    6: "turned by 90 degrees to the right",
    7: "mirrored and turned by 90 degrees to the right",
    8: "turned by 90 degrees to the left",
}


def read_picture(path: Path) -> Picture:
    """Read one picture, grey or blue-green-red as it was saved.

    Raises
    ------
    PictureError
        If the file is missing, a folder, unreadable, empty, truncated, not a picture, not of 8 bits a channel, too
        large, or not upright by its EXIF orientation.
    """
    return decode_picture(_read_bytes(path), path)


def decode_picture(data: bytes, path: Path | str) -> Picture:
    """Return the picture in the content of a file; `path` names it in messages. Raises as `read_picture`."""
    if _is_truncated(data):
        raise PictureError(
            f"{path} is truncated or damaged: {len(data)} bytes without an end", "copy it again"
        )
    shown = _SHOWN.get(_read_orientation(data))
    if shown is not None:
        raise PictureError(
            f"{path} is to be shown {shown} (EXIF orientation), so its pixels are not where a viewer shows them",
            "save it upright without that mark (mogrify -auto-orient turns it), every picture of this camera alike",
        )
    _check_pixels(data, path)
    try:
        image = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error as error:
        raise PictureError(f"{path} cannot be decoded: {error.err}", _CONVERT) from error
    if image is None:
        raise PictureError(f"{path} is not a picture", _CONVERT)
    if image.dtype != np.uint8:
        raise PictureError(f"{path} has {image.dtype} pixels, not 8 bits a channel", _CONVERT)
    if image.ndim == 3 and image.shape[2] == 4:
        image = image[:, :, :3]
    if image.ndim == 3 and image.shape[2] != 3:
        raise PictureError(f"{path} has {image.shape[2]} channels, not 1, 3 or 4", _CONVERT)
    return np.ascontiguousarray(image, dtype=np.uint8)


def number_order(path: Path) -> list[tuple[int, str]]:
    """Return the sort key of natural order: picture2 before picture10."""
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in re.split(r"(\d+)", path.name)]


def as_grey(image: Picture) -> Picture:
    """Return the picture in grey, (H, W); a grey picture is returned as it is."""
    return image if image.ndim == 2 else np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), dtype=np.uint8)


def size_of(image: Picture) -> tuple[int, int]:
    """Return the width and height [px]."""
    return int(image.shape[1]), int(image.shape[0])


def require_size(image: Picture, size: tuple[int, int] | None, what: str) -> None:
    """Raise PictureError unless the picture has the size (width, height) [px] of `what`; None allows any size."""
    found = size_of(image)
    if size is not None and found != size:
        raise PictureError(
            f"the picture has {found[0]} x {found[1]} pixels, {what} is for {size[0]} x {size[1]}",
            "use pictures of the camera setting that was calibrated, neither cropped nor scaled",
        )


def require_contrast(image: Picture) -> None:
    """Raise MeasurementRefusedError for a picture that shows nothing: black, white or even grey."""
    darkest, brightest, _, _ = cv2.minMaxLoc(as_grey(image))
    if brightest - darkest < _LEAST_RANGE:
        looks = (
            "black" if brightest < _LEAST_RANGE else "white" if darkest > 255 - _LEAST_RANGE else "even grey"
        )
        raise MeasurementRefusedError(
            f"the picture is {looks}: its grey levels lie between {darkest:.0f} and {brightest:.0f}",
            "look at the lamp, the lens cap and the exposure",
        )


def _read_bytes(path: Path) -> bytes:
    try:
        data = read_file(path, MAX_PICTURE_BYTES)
    except FileNotFoundError as error:
        raise PictureError(f"{path} does not exist", "check the path") from error
    except IsADirectoryError as error:
        raise PictureError(f"{path} is a folder, not a picture", "name the pictures in it") from error
    except OSError as error:
        raise PictureError(f"{path} cannot be read: {error.strerror}", "check its permissions") from error
    if not data:
        raise PictureError(f"{path} is empty", "copy it again")
    return data


def _check_pixels(data: bytes, path: Path | str) -> None:
    """Refuse a picture whose header states no size or too many pixels, before memory is taken for them."""
    width, height = _read_size(data)
    if not width or not height:
        raise PictureError(f"{path} is not a picture", _CONVERT)
    if width * height > MAX_PIXELS:
        raise PictureError(f"{path} has {width} x {height} pixels, at most {MAX_PIXELS} are read", "crop it")


def _read_size(data: bytes) -> tuple[int, int]:
    """Return the width and height that the header of a PNG, JPEG, BMP or TIFF states; 0 if it states none."""
    with suppress(struct.error):
        if data.startswith(PNG_SIGNATURE):
            width, height = struct.unpack_from(">II", data, 16)
            return width, height
        if data.startswith(_BMP):
            width, height = struct.unpack_from("<ii", data, 18)
            return abs(width), abs(height)
        if data.startswith(_JPEG):
            sizes = [body[1:5] for marker, body in _jpeg_segments(data) if marker in _JPEG_FRAMES]
            height, width = max((struct.unpack(">HH", size) for size in sizes), default=(0, 0))
            return width, height
    return _read_tiff_value(data, _WIDTH_TAG) or 0, _read_tiff_value(data, _HEIGHT_TAG) or 0


def _is_truncated(data: bytes) -> bool:
    """Return whether a JPEG or PNG has no end; decoders would silently fill the rest with grey."""
    if data.startswith(_JPEG):
        return data.find(b"\xff\xd9", _jpeg_scan_start(data)) < 0
    return data.startswith(PNG_SIGNATURE) and not _is_whole_png(data)


def _jpeg_scan_start(data: bytes) -> int:
    """Return where the picture's own scan starts, past any thumbnail with an end marker of its own."""
    position = 2
    for _, body in _jpeg_segments(data):
        position += 4 + len(body)
    return position


def _jpeg_segments(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield marker and body of each segment before the scan."""
    position = 2
    while position + 4 <= len(data) and data[position] == 0xFF and data[position + 1] != _JPEG_START_OF_SCAN:
        if data[position + 1] == 0xFF:  # a fill byte
            position += 1
            continue
        end = position + 2 + max(2, int.from_bytes(data[position + 2 : position + 4], "big"))
        yield data[position + 1], data[position + 4 : end]
        position = end


def _read_orientation(data: bytes) -> int:
    """Return the EXIF orientation of a JPEG, PNG or TIFF; upright if the file states none."""
    if data.startswith(_JPEG):
        bodies = [body for marker, body in _jpeg_segments(data) if marker == _JPEG_APP1]
        data = next((body[len(_EXIF) :] for body in bodies if body.startswith(_EXIF)), b"")
    elif data.startswith(PNG_SIGNATURE):
        data = next((body for kind, body, _ in list_png_chunks(data) if kind == _PNG_EXIF), b"")
    return _read_tiff_value(data, _ORIENTATION_TAG) or _UPRIGHT


def _read_tiff_value(tiff: bytes, wanted: int) -> int | None:
    """Return a number of one or two words in the first directory of TIFF data; None if missing or malformed."""
    order = {b"II*\x00": "<", b"MM\x00*": ">"}.get(tiff[:4])
    if order is None:
        return None
    with suppress(struct.error):
        (start,) = struct.unpack_from(f"{order}I", tiff, 4)
        (entries,) = struct.unpack_from(f"{order}H", tiff, start)
        for entry in range(entries):
            place = start + 2 + 12 * entry
            tag, kind = struct.unpack_from(f"{order}HH", tiff, place)
            if tag == wanted:
                (value,) = struct.unpack_from(order + ("I" if kind == _TIFF_LONG else "H"), tiff, place + 8)
                return int(value)
    return None


def list_png_chunks(data: bytes) -> Iterator[tuple[bytes, bytes, int]]:
    """Yield kind, body and stated checksum of each chunk; a truncated chunk has a wrong checksum."""
    position = len(PNG_SIGNATURE)
    while position + 12 <= len(data):
        end = position + 8 + int.from_bytes(data[position : position + 4], "big")
        yield (
            data[position + 4 : position + 8],
            data[position + 8 : end],
            int.from_bytes(data[end : end + 4], "big"),
        )
        position = end + 4


def _is_whole_png(data: bytes) -> bool:
    """Return whether every chunk up to the end chunk is present with a correct checksum."""
    for kind, body, checksum in list_png_chunks(data):
        if zlib.crc32(body, zlib.crc32(kind)) != checksum:
            return False
        if kind == _PNG_END:
            return True
    return False
