"""Pictures on disk: one file each, as PNG, or as PGM (PPM in colour) for cameras too fast for PNG.

A PNG has half the size, but takes a processor about 7 ms a megapixel; a PGM file takes a tenth of that. The line of a
picture in frames.jsonl gives its file and its SHA-256.
"""

import hashlib
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from labrig.durable import sync_directory, sync_file, write_and_rename
from labrig.errors import InputError, PictureError, RecordError
from labrig.input_file import read_file
from labrig.record.events import FrameLine, parse_lines
from labrig.record.layout import COPY_HINT, FRAME_LINES, FRAMES, inside, picture_file
from labrig.vision.picture import MAX_PICTURE_BYTES, decode_picture

Picture = NDArray[np.uint8]
Store = Literal["png", "pgm"]

# Lossless. The strategy is named because a compression level alone would select one that takes twice as long. On noisy
# pictures Huffman-only coding and other filters differ from this by less than a tenth of the time and 5 % of the
# size; on clean pictures run-length coding is twice as fast and half as large.
_PNG_SETTINGS = (cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_RLE)


class PictureWriter:
    """Writes the pictures of a run as frames/NNNNNN.png (or .pgm, .ppm), each complete under its name."""

    def __init__(self, run: Path, store: Store) -> None:
        self._run = run
        self._store = store
        self._unsynced: deque[Path] = deque()

    def write(self, number: int, image: Picture) -> tuple[str, str]:
        """Write a picture and return its file and SHA-256, for its line. Raises `OSError`, `InputError`."""
        grey_or_bgr = image.ndim == 2 or (image.ndim == 3 and image.shape[2] == 3)
        if image.dtype != np.uint8 or not grey_or_bgr or image.size == 0:
            raise InputError(
                f"a picture is a uint8 array (H, W) or (H, W, 3); got {image.dtype} {image.shape}",
                "set the camera to 8-bit grey or BGR",
            )
        suffix = ".png" if self._store == "png" else (".pgm" if image.ndim == 2 else ".ppm")
        settings = _PNG_SETTINGS if suffix == ".png" else ()
        _, encoded = cv2.imencode(suffix, np.ascontiguousarray(image), settings)
        content = encoded.tobytes()
        file = picture_file(number, suffix)
        write_and_rename(self._run / file, content, sync=False)
        self._unsynced.append(self._run / file)
        return file, hashlib.sha256(content).hexdigest()

    def sync(self) -> None:
        """Make the pictures so far durable, then their names; another thread may write more meanwhile."""
        written = len(self._unsynced)
        for _ in range(written):
            sync_file(self._unsynced[0])
            self._unsynced.popleft()
        if written:
            sync_directory(self._run / FRAMES)


@dataclass(frozen=True)
class RecordedPicture:
    """A picture of a run: the run's folder, and the line of the picture."""

    run: Path
    line: FrameLine

    def read(self) -> Picture:
        """Return the picture, (H, W) or (H, W, 3) of uint8. Raises `RecordError` if it is missing or was changed."""
        path = inside(self.run, self.line.file)
        try:
            content = read_file(path, MAX_PICTURE_BYTES)
        except OSError as error:
            raise RecordError(f"cannot read {path}: {error.strerror}", COPY_HINT) from error
        if hashlib.sha256(content).hexdigest() != self.line.sha256:
            raise RecordError(f"{path} is damaged: its SHA-256 does not fit {FRAME_LINES}", COPY_HINT)
        try:
            if path.suffix == ".png":
                return decode_picture(content, path)
            return np.asarray(cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED), np.uint8)
        except (PictureError, TypeError) as error:  # of what is no PGM or PPM OpenCV makes None
            raise RecordError(f"{path} is no picture: {error}", COPY_HINT) from error


def locate_pictures(
    run: Path, lines: Sequence[Mapping[str, object]], first: int = 0
) -> tuple[RecordedPicture, ...]:
    """Return the pictures of lines of frames.jsonl that begin with a number.

    Raises
    ------
    RecordError
        When a line is not what it has to be, or of another picture or file; names file and line.
    """
    pictures = []
    for number, line in enumerate(parse_lines(run / FRAME_LINES, lines, FrameLine, first), start=first):
        files = {picture_file(number, suffix) for suffix in (".png", ".pgm", ".ppm")}
        if line.frame != number or line.file not in files:
            message = f"{run / FRAME_LINES}:{number + 1}: it is not the line of picture {number}"
            raise RecordError(message, COPY_HINT)
        pictures.append(RecordedPicture(run, line))
    return tuple(pictures)
