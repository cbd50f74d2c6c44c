"""Pictures from files: the one place where labrig reads one, and what it refuses.

A picture is a uint8 array, (H, W) grey or (H, W, 3) blue-green-red, of the sensor's own pixels: an
orientation noted by the camera (EXIF) is ignored, because a calibration is about the sensor and not about how
the camera was held. An alpha channel is dropped. Other depths are refused rather than scaled, because a
guessed scale changes what is measured.
"""

import zlib
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from labrig.errors import PictureError

Picture = NDArray[np.uint8]

_JPEG = b"\xff\xd8\xff"
_JPEG_START_OF_SCAN = 0xDA
_PNG = b"\x89PNG\r\n\x1a\n"
_CONVERT = "save it as an 8-bit PNG or JPEG"


def read_picture(path: Path) -> Picture:
    """Read one picture, grey or blue-green-red as it was saved.

    Raises
    ------
    PictureError
        If the file is missing, a folder, unreadable, empty, truncated, no picture, or not of 8 bits a
        channel.
    """
    data = _read_bytes(path)
    if _is_torn(data):
        raise PictureError(
            f"{path} is truncated or damaged: {len(data)} bytes without an end", "copy it again"
        )
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


def as_grey(image: Picture) -> Picture:
    """Return the picture in grey, (H, W); grey ones as they are."""
    return image if image.ndim == 2 else np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), dtype=np.uint8)


def size_of(image: Picture) -> tuple[int, int]:
    """Return the width and height [px]."""
    return int(image.shape[1]), int(image.shape[0])


def require_size(image: Picture, size: tuple[int, int], what: str) -> None:
    """Raise PictureError unless the picture has the size (width, height) [px] that `what` is for."""
    found = size_of(image)
    if found != size:
        raise PictureError(
            f"the picture has {found[0]} x {found[1]} pixels, {what} is for {size[0]} x {size[1]}",
            "use pictures of the camera setting that was calibrated, neither cropped nor scaled",
        )


def _read_bytes(path: Path) -> bytes:
    try:
        data = path.read_bytes()
    except FileNotFoundError as error:
        raise PictureError(f"{path} does not exist", "check the path") from error
    except IsADirectoryError as error:
        raise PictureError(f"{path} is a folder, not a picture", "name the pictures in it") from error
    except OSError as error:
        raise PictureError(f"{path} cannot be read: {error.strerror}", "check its permissions") from error
    if not data:
        raise PictureError(f"{path} is empty", "copy it again")
    return data


def _is_torn(data: bytes) -> bool:
    """Return whether a JPEG or PNG has no end; decoders would fill the rest with grey and say nothing."""
    if data.startswith(_JPEG):
        return data.find(b"\xff\xd9", _jpeg_scan_start(data)) < 0
    return data.startswith(_PNG) and not _png_is_whole(data)


def _jpeg_scan_start(data: bytes) -> int:
    """Return where the picture's own scan starts, past any thumbnail with an end marker of its own."""
    position = 2
    while position + 4 <= len(data) and data[position] == 0xFF and data[position + 1] != _JPEG_START_OF_SCAN:
        position += 2 + int.from_bytes(data[position + 2 : position + 4], "big")
    return position


def _png_is_whole(data: bytes) -> bool:
    """Return whether every chunk is there with its checksum, up to the end chunk."""
    position = len(_PNG)
    while position + 12 <= len(data):
        length = int.from_bytes(data[position : position + 4], "big")
        body, end = data[position + 4 : position + 8 + length], position + 12 + length
        if zlib.crc32(body) != int.from_bytes(data[end - 4 : end], "big"):
            return False
        if body[:4] == b"IEND":
            return True
        position = end
    return False
