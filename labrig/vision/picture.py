"""Pictures and masks from files: the only place where labrig reads a picture, and what it refuses.

A picture is a uint8 array, (H, W) grey or (H, W, 3) blue-green-red, of the sensor's own pixels. A picture whose EXIF
orientation is not upright is refused: viewers turn or mirror it, so a pixel or a direction that a person reads in a
viewer is not the one that is measured. An alpha channel is dropped. Other depths are refused rather than scaled,
because a guessed scale changes the measurement.
"""

import re
import struct
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from io import BytesIO
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import ExifTags, Image

from labrig.errors import MeasurementRefusedError, PictureError
from labrig.input_file import read_file

Picture = NDArray[np.uint8]
Mask = NDArray[np.bool_]
"""Which pixels (H, W) are not the needle."""

PICTURE_SUFFIXES = frozenset({".bmp", ".jpeg", ".jpg", ".png", ".tif", ".tiff"})
"""Suffixes of picture files."""

MAX_PICTURE_BYTES = 2**28
MAX_PIXELS = 2**26
"""The largest picture that is decoded: 8192 x 8192 pixels."""

_FORMATS = ("PNG", "JPEG", "BMP", "TIFF")
# Pillow's names of pixels of 8 bits a channel; transparency is dropped.
_GREY = frozenset({"1", "L", "LA"})
_COLOURED = frozenset({"P", "PA", "RGB", "RGBA", "CMYK", "YCbCr"})
# What Pillow raises for a file that it cannot read.
_DAMAGE = (OSError, SyntaxError, ValueError, EOFError, struct.error)
# The size is checked here, before anything is decoded.
Image.MAX_IMAGE_PIXELS = None
# Least range of grey levels of a picture that shows something.
_LEAST_RANGE = 8
# Masked pixels are at least as light as this.
_WHITE = 128
# Sides of the boxes [px] whose mean fills a masked pixel, and the least visible share of a box.
_BOXES_PX = (15, 61, 241, 961)
_LEAST_SEEN = 0.2
_CONVERT = "save it as an 8-bit PNG or JPEG"


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
    try:
        with _open(data) as picture:
            _check_header(picture, path)
            if picture.format == "PNG":
                # Its checksums are not compared where it is decoded.
                with _open(data) as again:
                    again.verify()
            if picture.mode not in _GREY | _COLOURED:
                raise PictureError(
                    f"{path} has pixels of kind {picture.mode}, not 8 bits a channel", _CONVERT
                )
            grey = picture.mode in _GREY
            pixels = np.asarray(picture.convert("L" if grey else "RGB"))
    except PictureError:
        raise
    except _DAMAGE as error:
        why = str(error).partition(" <")[0]  # Pillow ends with the object that it reads, and its address
        raise PictureError(f"{path} is truncated, damaged, or no picture: {why}", _CONVERT) from error
    return np.asarray(pixels if grey else cv2.cvtColor(pixels, cv2.COLOR_RGB2BGR), dtype=np.uint8)


def number_order(path: Path) -> list[tuple[int, str]]:
    """Return the sort key of natural order: picture2 before picture10."""
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in re.split(r"(\d+)", path.name)]


def as_grey(image: Picture) -> Picture:
    """Return the picture in grey, (H, W); a grey picture is returned as it is."""
    return image if image.ndim == 2 else np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), dtype=np.uint8)


def size_of(image: Picture | Mask) -> tuple[int, int]:
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


def load_mask(path: Path) -> Mask:
    """Read a mask: a picture that is white where a person marks pixels as not the needle. Raises as `read_picture`."""
    return np.asarray(as_grey(read_picture(path)) >= _WHITE)


def fill_masked(picture: Picture, mask: Mask | None) -> Picture:
    """Return a grey picture whose masked pixels have the grey value of their surroundings.

    Raises
    ------
    PictureError
        If the mask is of another size.
    """
    if mask is None:
        return picture
    require_size(picture, size_of(mask), "the mask")
    seen = (~mask).astype(np.float32)
    result = picture.copy()
    missing = mask
    # Ever larger boxes, until enough of the surroundings is visible.
    for side in _BOXES_PX:
        weight = cv2.blur(seen, (side, side))
        mean = cv2.blur(picture.astype(np.float32) * seen, (side, side)) / np.maximum(weight, 1e-6)
        known = missing & (weight > _LEAST_SEEN)
        result[known] = np.rint(mean[known]).astype(np.uint8)
        missing = missing & ~known
    return result


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


def _check_header(picture: Image.Image, path: Path | str) -> None:
    """Refuse a picture that is too large, or to be shown turned, before memory is taken for its pixels."""
    width, height = picture.size
    if width * height > MAX_PIXELS:
        raise PictureError(f"{path} has {width} x {height} pixels, at most {MAX_PIXELS} are read", "crop it")
    orientation = _read_orientation(picture)
    if orientation in range(2, 9):
        raise PictureError(
            f"{path} is to be shown turned or mirrored (EXIF orientation {orientation}), so its pixels are not where a "
            "viewer shows them",
            "save it upright without that mark (mogrify -auto-orient turns it), every picture of this camera alike",
        )


@contextmanager
def _open(data: bytes) -> Iterator[Image.Image]:
    with warnings.catch_warnings(action="ignore"), Image.open(BytesIO(data), formats=_FORMATS) as picture:
        yield picture


def _read_orientation(header: Image.Image) -> int:
    """Return the EXIF orientation of an opened picture; upright if it states none, or nothing that can be read."""
    with suppress(SyntaxError, ValueError, struct.error):
        exif = Image.Exif()
        exif.load(header.info.get("exif", b""))
        return int((header.getexif() if header.format == "TIFF" else exif).get(ExifTags.Base.Orientation, 1))
    return 1
