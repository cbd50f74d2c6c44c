"""Pictures of a run for the page: a JPEG, and lines over it in its own pixels."""

import base64
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from labrig.errors import RecordError
from labrig.record.reader import Run
from labrig.vision.picture import Picture, size_of
from labrig.vision.plane import PlaneMap

FloatArray = NDArray[np.float64]
Pixel = tuple[float, float]


@dataclass(frozen=True)
class JpegSize:
    """The largest width of a JPEG, and its quality."""

    width_px: int
    quality: int


THUMBNAIL = JpegSize(640, 70)
PLATE = JpegSize(840, 75)


@dataclass(frozen=True)
class Plate:
    """A recorded picture, and what is drawn over it in its own pixels, whatever size the JPEG has.

    Attributes
    ----------
    href : str
        The JPEG as a data URI.
    width, height : int
        Of the recorded picture [px].
    lines : sequence of (str, str)
        Names, and the `points` of SVG polylines.
    words : sequence of (str, (float, float))
        Words, and where they begin.
    bar : (float, ((float, float), (float, float))) or None
        Length and ends of a scale bar [mm, px].
    """

    href: str
    width: int
    height: int
    lines: Sequence[tuple[str, str]] = ()
    words: Sequence[tuple[str, Pixel]] = ()
    bar: tuple[float, tuple[Pixel, Pixel]] | None = None

    @property
    def size(self) -> tuple[int, int]:
        """Width and height [px]."""
        return self.width, self.height


def data_uri(content: bytes, kind: str) -> str:
    """Return bytes as a data URI."""
    return f"data:{kind};base64,{base64.b64encode(content).decode('ascii')}"


def jpeg(image: Picture, size: JpegSize) -> bytes:
    """Return a picture as JPEG, reduced if it is wider than the size."""
    width, height = size_of(image)
    if width > size.width_px:
        smaller = (size.width_px, max(1, round(height * size.width_px / width)))
        image = np.asarray(cv2.resize(image, smaller, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    _, content = cv2.imencode(".jpg", image, (cv2.IMWRITE_JPEG_QUALITY, size.quality))
    return content.tobytes()


def photograph(run: Run, frame: int, size: JpegSize) -> Plate | None:
    """Return a recorded picture for the page, with nothing over it; None if it cannot be read."""
    try:
        image = run.read_frame(frame)
    except RecordError:
        return None
    return Plate(data_uri(jpeg(image, size), "image/jpeg"), *size_of(image))


def polyline(px: FloatArray) -> str:
    """Return pixels (N, 2) as the `points` of an SVG polyline."""
    return " ".join(f"{u:.1f},{v:.1f}" for u, v in px)


def circle(centre_mm: Sequence[float], radius_mm: float, plane: PlaneMap, points: int = 73) -> FloatArray:
    """Return the pixels (N, 2) of a circle of the steering plane, its first point again at the end."""
    angle = np.linspace(0.0, 2.0 * np.pi, points)
    return plane.to_px(np.asarray(centre_mm) + radius_mm * np.column_stack((np.cos(angle), np.sin(angle))))


def map_path(path_mm: ArrayLike, true_mm: Sequence[float], mapped_mm: Sequence[float]) -> FloatArray:
    """Return a path (N, 2), (y, z) [mm], as a map has it that puts `true_mm` at `mapped_mm` and is right at its origin.

    What turns or stretches a map grows from there.
    """
    path = np.asarray(path_mm, dtype=np.float64).reshape(-1, 2)
    return path + np.outer(path[:, 1] / true_mm[1], np.subtract(mapped_mm, true_mm))


def scale_bar(size: tuple[int, int], plane: PlaneMap) -> tuple[float, tuple[Pixel, Pixel]]:
    """Return a length of 1, 2, 5, 10 ... mm above a tenth of the picture's width, and the ends of its bar.

    The bar is near the lower left corner, along the axis that is closer to horizontal.
    """
    width, height = size
    tenth_mm = width * plane.mm_per_px / 10.0
    lengths: Sequence[float] = [step * 10.0**power for power in range(-3, 5) for step in (1.0, 2.0, 5.0)]
    length_mm = next(length for length in lengths if length >= tenth_mm)
    corner = np.array([[0.05 * width, 0.94 * height]])
    start_mm = plane.to_mm(corner)
    moves = plane.to_px(start_mm + length_mm * np.eye(2)) - corner
    level = int(np.argmax(np.abs(moves[:, 0])))
    # An axis that points left would lead out of the picture.
    direction = np.sign(moves[level, 0]) * np.eye(2)[level]
    return length_mm, (pixel(corner[0]), pixel(plane.to_px(start_mm + length_mm * direction)[0]))


def pixel(px: FloatArray) -> Pixel:
    """Return a pixel (2,) rounded for drawing."""
    return round(float(px[0]), 1), round(float(px[1]), 1)
