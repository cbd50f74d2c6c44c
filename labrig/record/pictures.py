"""Pictures on disk: one file each, as PNG, or as PGM (PPM in colour) for cameras too fast for PNG.

A PNG has half the size, but takes a processor about 7 ms a megapixel; a PGM file takes a tenth of that. The line of a
picture in frames.jsonl gives its file and its SHA-256.
"""

import hashlib
import re
from collections import deque
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from labrig.durable import sync_directory, sync_file, write_and_rename
from labrig.errors import InputError, PictureError, RecordError
from labrig.input_file import MAX_LOG_BYTES, read_file
from labrig.record.layout import COPY_HINT, FRAME_LINES, FRAMES, inside, picture_file
from labrig.vision.picture import MAX_PICTURE_BYTES, decode_picture

Picture = NDArray[np.uint8]
Store = Literal["png", "pgm"]

SUFFIXES = (".png", ".pgm", ".ppm")

_PNM_HEADER = re.compile(rb"P([56])\s(\d{1,5})\s(\d{1,5})\s255\s")

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

    def write(self, number: int, image: Picture) -> dict[str, object]:
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
        return {"file": file, "sha256": hashlib.sha256(content).hexdigest()}

    def sync(self) -> None:
        """Make the pictures so far durable, then their names; another thread may write more meanwhile."""
        written = len(self._unsynced)
        for _ in range(written):
            with suppress(FileNotFoundError):  # its line could not be written, and it was removed
                sync_file(self._unsynced[0])
            self._unsynced.popleft()
        if written:
            sync_directory(self._run / FRAMES)


@dataclass(frozen=True)
class RecordedPicture:
    """A picture of a run: the run's folder, its file relative to that, and its SHA-256 when it was taken."""

    run: Path
    file: str
    sha256: str

    def read(self) -> Picture:
        """Return the picture, (H, W) or (H, W, 3) of uint8. Raises `RecordError` if it is missing or was changed."""
        path = inside(self.run, self.file)
        try:
            content = read_file(path, MAX_PICTURE_BYTES)
        except OSError as error:
            raise RecordError(f"cannot read {path}: {error.strerror}", COPY_HINT) from error
        if hashlib.sha256(content).hexdigest() != self.sha256:
            raise RecordError(f"{path} is damaged: its SHA-256 does not fit {FRAME_LINES}", COPY_HINT)
        try:
            return decode_picture(content, path) if path.suffix == ".png" else _decode_pnm(content)
        except (PictureError, ValueError) as error:
            raise RecordError(f"{path} is no picture: {error}", COPY_HINT) from error


def _decode_pnm(content: bytes) -> Picture:
    """Return a picture of a PGM or PPM file, in which colour is red-green-blue. Raises `ValueError`."""
    header = _PNM_HEADER.match(content)
    if header is None:
        raise ValueError("it does not begin as PGM or PPM of 8 bits")
    is_grey, width, height = header[1] == b"5", int(header[2]), int(header[3])
    pixels = np.frombuffer(content, np.uint8, offset=header.end())
    return pixels.reshape(height, width) if is_grey else pixels.reshape(height, width, 3)[:, :, ::-1]


def locate_picture(run: Path, line: Mapping[str, object]) -> RecordedPicture | None:
    """Return the picture of a line of frames.jsonl; None if the line gives no valid file."""
    file, sha256, frame = line.get("file"), line.get("sha256"), line.get("frame")
    if not isinstance(sha256, str) or not isinstance(frame, int) or isinstance(frame, bool):
        return None
    names = {picture_file(frame, suffix) for suffix in SUFFIXES}
    return RecordedPicture(run, file, sha256) if isinstance(file, str) and file in names else None


def count_pictures(run: Path) -> int:
    """Return how many pictures frames.jsonl lists, without decoding it; 0 if it cannot be read."""
    try:
        return read_file(inside(run, FRAME_LINES), MAX_LOG_BYTES).count(b"\n")
    except (OSError, RecordError):
        return 0
