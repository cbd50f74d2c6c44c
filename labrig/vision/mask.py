"""Pixels that a person marks as not the needle, by a picture or by polygons.

The paper's authors removed such pixels by hand. Here a file marks them, and the record keeps it. The file is either a
picture of the same size, white where pixels are masked, for all pictures; or polygons, for all pictures under "*", or
for a single picture under its file name::

    {"*": [[[0, 700], [1279, 700], [1279, 719]]], "000012.png": [[[600, 300], [640, 300], [640, 330]]]}
"""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import TypeAdapter, ValidationError

from labrig.errors import FileFormatError, InputError, Problem
from labrig.input_file import parse_json, read_file
from labrig.vision.picture import MAX_PICTURE_BYTES, Picture, as_grey, read_picture, require_size, size_of

BoolArray = NDArray[np.bool_]
Polygon = tuple[tuple[float, float], ...]

EVERY_PICTURE = "*"
_WHITE = 128
_POLYGONS: TypeAdapter[dict[str, tuple[Polygon, ...]]] = TypeAdapter(dict[str, tuple[Polygon, ...]])
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
    polygons : Mapping
        Polygons [px] by the name of the picture; "*" applies to all pictures.
    source : str
        Name of the file.
    content : bytes
        Content of the file, for the record.
    """

    picture: Picture | None
    polygons: Mapping[str, tuple[Polygon, ...]]
    source: str
    content: bytes

    @property
    def sha256(self) -> str:
        """Return the hash of the file's content."""
        return hashlib.sha256(self.content).hexdigest()

    @property
    def kept_name(self) -> str:
        """Return the name under which a result keeps the file."""
        return "mask.json" if self.picture is None else f"mask{Path(self.source).suffix.lower()}"

    def find_masked(self, name: str, image: Picture) -> BoolArray | None:
        """Return which pixels (H, W) of the picture of this name are masked; None if the mask has no polygon for it.

        Raises
        ------
        PictureError
            If the mask is a picture of another size.
        """
        width, height = size_of(image)
        if self.picture is not None:
            require_size(image, size_of(self.picture), f"the mask {self.source}")
            return np.asarray(self.picture >= _WHITE)
        wanted = (*self.polygons.get(EVERY_PICTURE, ()), *self.polygons.get(name, ()))
        if not wanted:
            return None
        drawn = np.zeros((height, width), np.uint8)
        for polygon in wanted:
            fixed = np.rint(np.array(polygon) * 2**_SUBPIXEL_BITS).astype(np.int32)
            cv2.fillPoly(drawn, [fixed], 255, shift=_SUBPIXEL_BITS)
        return np.asarray(drawn > 0)

    def with_names(self, names: Mapping[str, str]) -> "Mask":
        """Return the mask with its polygons also under the names of copies; `names` maps a copy to its original."""
        known = {copy: self.polygons[name] for copy, name in names.items() if name in self.polygons}
        return replace(self, polygons={**self.polygons, **known})


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
        picture = as_grey(read_picture(path))
        return Mask(picture, {}, path.name, read_file(path, MAX_PICTURE_BYTES))
    try:
        data = read_file(path)
        found = _POLYGONS.validate_python(parse_json(data))
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror}", "check the path") from error
    except (ValueError, ValidationError) as error:
        raise _make_format_error(path, str(error).splitlines()[0]) from error
    for name, polygons in found.items():
        for polygon in polygons:
            if len(polygon) < _LEAST_CORNERS or not np.isfinite(polygon).all():
                raise _make_format_error(
                    path,
                    f"{name!r} has a polygon of {len(polygon)} corners, or with a corner that is not finite",
                )
            if np.abs(polygon).max() > _FARTHEST_PX:
                raise _make_format_error(
                    path, f"{name!r} has a corner more than {_FARTHEST_PX} px from the picture's"
                )
            if np.abs(polygon).max() > _FARTHEST_PX:
                raise _make_format_error(path, f"{name!r} has a corner farther out than {_FARTHEST_PX} px")
    return Mask(None, found, path.name, data)


def _make_format_error(path: Path, what: str) -> FileFormatError:
    hint = 'polygons by picture, "*" for all: {"*": [[[0, 0], [100, 0], [100, 50]]]}'
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
