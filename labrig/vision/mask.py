"""Pixels that a person marks as not the needle, by a picture or by polygons.

The paper's authors removed such pixels by hand. Here a file marks them, and the record keeps it. The file is either a
picture of the same size, white where pixels are masked, or a list of polygons [px]::

    [[[0, 700], [1279, 700], [1279, 719]], [[600, 300], [640, 300], [640, 330]]]
"""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import TypeAdapter, ValidationError

from labrig.errors import FileFormatError, InputError, Problem
from labrig.input_file import parse_json, read_file
from labrig.vision.picture import Picture, as_grey, read_picture, require_size, size_of

BoolArray = NDArray[np.bool_]
Polygon = tuple[tuple[float, float], ...]

_WHITE = 128
_POLYGONS: TypeAdapter[tuple[Polygon, ...]] = TypeAdapter(tuple[Polygon, ...])
_LEAST_CORNERS = 3
_FARTHEST_PX = 2**20  # no picture is that large; drawn in 32-bit integers, far corners would wrap round
_SUBPIXEL_BITS = 4
# Sides of the boxes [px] whose mean fills a masked pixel, and the least visible share of a box.
_BOXES_PX = (15, 61, 241, 961)
_LEAST_SEEN = 0.2


@dataclass(frozen=True, eq=False)
class Mask:
    """Pixels that are not the needle.

    Attributes
    ----------
    picture : ndarray of uint8 (H, W) or None
        White at masked pixels.
    polygons : tuple
        Polygons [px], each a tuple of corners (u, v).
    source : str
        Name of the file.
    """

    picture: Picture | None
    polygons: tuple[Polygon, ...]
    source: str

    def find_masked(self, image: Picture) -> BoolArray:
        """Return which pixels (H, W) of a picture are masked.

        Raises
        ------
        PictureError
            If the mask is a picture of another size.
        """
        if self.picture is not None:
            require_size(image, size_of(self.picture), f"the mask {self.source}")
            return np.asarray(self.picture >= _WHITE)
        width, height = size_of(image)
        drawn = np.zeros((height, width), np.uint8)
        for polygon in self.polygons:
            fixed = np.rint(np.array(polygon) * 2**_SUBPIXEL_BITS).astype(np.int32)
            cv2.fillPoly(drawn, [fixed], 255, shift=_SUBPIXEL_BITS)
        return np.asarray(drawn > 0)


def load_mask(path: Path) -> Mask:
    """Read a mask: a picture, or polygons as JSON.

    Raises
    ------
    FileFormatError
        If a JSON file does not hold polygons.
    InputError
        If the file cannot be read, or (as PictureError) is not a picture.
    """
    if path.suffix.lower() != ".json":
        return Mask(as_grey(read_picture(path)), (), path.name)
    try:
        polygons = _POLYGONS.validate_python(parse_json(read_file(path)))
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror}", "check the path") from error
    except (ValueError, ValidationError) as error:
        raise _make_format_error(path, str(error).splitlines()[0]) from error
    for polygon in polygons:
        if len(polygon) < _LEAST_CORNERS or not np.isfinite(polygon).all():
            raise _make_format_error(path, f"one has {len(polygon)} corners, or a corner that is not finite")
        if np.abs(polygon).max() > _FARTHEST_PX:
            raise _make_format_error(path, f"one has a corner more than {_FARTHEST_PX} px from the picture's")
    return Mask(None, polygons, path.name)


def _make_format_error(path: Path, what: str) -> FileFormatError:
    hint = "a list of polygons: [[[0, 0], [100, 0], [100, 50]]]"
    return FileFormatError((Problem(str(path), f"holds no polygons: {what}", hint),))


def fill_masked(picture: Picture, masked: BoolArray | None) -> Picture:
    """Return a grey picture whose masked pixels have the grey value of their surroundings."""
    if masked is None or not masked.any():
        return picture
    seen = (~masked).astype(np.float32)
    result = picture.copy()
    missing = masked
    # Ever larger boxes, until enough of the surroundings is visible.
    for side in _BOXES_PX:
        weight = cv2.blur(seen, (side, side))
        mean = cv2.blur(picture.astype(np.float32) * seen, (side, side)) / np.maximum(weight, 1e-6)
        known = missing & (weight > _LEAST_SEEN)
        result[known] = np.rint(mean[known]).astype(np.uint8)
        missing = missing & ~known
    return result
