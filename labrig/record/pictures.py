"""Pictures on disk: a PNG each, or concatenated in frames.raw for cameras too fast for PNG.

A PNG has half the size and opens anywhere, but takes a processor about 7 ms a megapixel; `frames.raw` takes a tenth of
that. Either way the picture's line in frames.jsonl gives its place and its SHA-256.
"""

import hashlib
import math
from collections import deque
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from labrig.durable import sync_file, write_and_rename
from labrig.errors import InputError, PictureError, RecordError
from labrig.input_file import MAX_LOG_BYTES, open_file, read_file
from labrig.posix import sync_directory
from labrig.record.intact import Identity, identify, is_intact, remember_intact
from labrig.record.layout import COPY_HINT, FRAME_LINES, FRAMES, RAW_PICTURES, inside, picture_file
from labrig.record.line_file import LineFile
from labrig.vision.picture import MAX_PICTURE_BYTES, decode_picture

Picture = NDArray[np.uint8]
Store = Literal["png", "raw"]

# Lossless. The strategy is named because a compression level alone would select one that takes twice as long. On noisy
# pictures Huffman-only coding and other filters differ from this by less than a tenth of the time and 5 % of the
# size; on clean pictures run-length coding is twice as fast and half as large.
_PNG_SETTINGS = (cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_RLE)
_DIGEST_BYTES = hashlib.sha256().digest_size


class PictureWriter(Protocol):
    """Writes the pictures of a run."""

    def write(self, number: int, image: Picture) -> dict[str, object]:
        """Write a picture and return its place, for its line. Raises `OSError`, `InputError`."""

    def withdraw(self, number: int) -> None:
        """Remove the picture just written, because its line cannot be. Raises `OSError`."""

    def sync(self) -> None:
        """Make the pictures so far durable; another thread may write more meanwhile. Raises `OSError`."""

    def sums(self, frames: int) -> dict[str, str]:
        """Return the SHA-256 of each file written; the first `frames` pictures have lines."""

    def close(self) -> None:
        """Close the files."""


def open_picture_writer(run: Path, store: Store, first: int) -> PictureWriter:
    """Return the writer of pictures from number `first` on. Raises `OSError`."""
    return RawPictures(run) if store == "raw" else PngPictures(run, first)


class PngPictures:
    """Pictures as frames/NNNNNN.png, each complete under its name."""

    def __init__(self, run: Path, first: int) -> None:
        self._run = run
        self._first = first
        self._digests = bytearray()
        self._unsynced: deque[int] = deque()

    def write(self, number: int, image: Picture) -> dict[str, object]:
        """Write a picture under a temporary name and rename it into place."""
        _, encoded = cv2.imencode(".png", np.ascontiguousarray(_require_picture(image)), _PNG_SETTINGS)
        content = encoded.tobytes()
        digest = hashlib.sha256(content)
        write_and_rename(self._run / picture_file(number), content, sync=False)
        self._unsynced.append(number)
        # Ten minutes are 18,000 pictures, so names are not kept.
        start = _DIGEST_BYTES * (number - self._first)
        self._digests[start : start + _DIGEST_BYTES] = digest.digest()
        return {"file": picture_file(number), "sha256": digest.hexdigest()}

    def withdraw(self, number: int) -> None:
        """Remove the file."""
        (self._run / picture_file(number)).unlink()

    def sync(self) -> None:
        """Make the contents durable, then the names."""
        written = len(self._unsynced)
        for _ in range(written):
            with suppress(FileNotFoundError):  # it was withdrawn
                sync_file(self._run / picture_file(self._unsynced[0]))
            self._unsynced.popleft()
        if written:
            sync_directory(self._run / FRAMES)

    def sums(self, frames: int) -> dict[str, str]:
        """Return the SHA-256 of each picture."""
        starts = range(0, _DIGEST_BYTES * (frames - self._first), _DIGEST_BYTES)
        digests = (bytes(self._digests[start : start + _DIGEST_BYTES]).hex() for start in starts)
        return {picture_file(number): digest for number, digest in enumerate(digests, start=self._first)}

    def close(self) -> None:
        """Do nothing: no file is open."""


class RawPictures:
    """Pictures concatenated in frames.raw, row by row; each is complete before its line is written."""

    def __init__(self, run: Path) -> None:
        path = run / RAW_PICTURES
        self._file = LineFile.reopen(path) if path.exists() else LineFile.create(path)

    def write(self, number: int, image: Picture) -> dict[str, object]:  # noqa: ARG002 - the line holds it
        """Append a picture."""
        content = np.ascontiguousarray(_require_picture(image)).tobytes()
        end = self._file.append_raw(content)
        return {
            "file": RAW_PICTURES,
            "sha256": hashlib.sha256(content).hexdigest(),
            "offset": end - len(content),
            "shape": list(image.shape),
        }

    def withdraw(self, number: int) -> None:  # noqa: ARG002 - it is the last
        """Cut it off."""
        self._file.cut_last()

    def sync(self) -> None:
        """Make the pictures so far durable."""
        self._file.sync()

    def sums(self, frames: int) -> dict[str, str]:  # noqa: ARG002 - one file holds all of them
        """Return the SHA-256 of the file."""
        return {RAW_PICTURES: self._file.sha256}

    def close(self) -> None:
        """Close the file."""
        self._file.close()


@dataclass(frozen=True)
class RecordedPicture:
    """The place of a picture of a run, and its SHA-256 when it was taken.

    Attributes
    ----------
    run : Path
        The folder of the run.
    file : str
        Its name relative to that.
    sha256 : str
        Hash of the file, or of the picture's bytes in frames.raw.
    offset : int
        Its start in frames.raw [bytes].
    shape : tuple of int or None
        (H, W) or (H, W, 3) of a picture in frames.raw; None for a PNG.
    """

    run: Path
    file: str
    sha256: str
    offset: int = 0
    shape: tuple[int, ...] | None = None

    def read(self) -> Picture:
        """Return the picture, (H, W) or (H, W, 3) of uint8. Raises `RecordError` if it is missing or was changed."""
        identity = self.identify()
        content = self._read_content()
        if not is_intact(identity):
            self._require_hash(content)
            remember_intact(identity)
        if self.shape is not None:
            return np.frombuffer(content, np.uint8).reshape(self.shape)
        try:
            return decode_picture(content, self.run / self.file)
        except PictureError as error:
            raise RecordError(error.message, COPY_HINT) from error

    def check(self) -> None:
        """Read the picture, even if it is known to be intact. Raises `RecordError` as `read` does."""
        self._require_hash(self._read_content())

    def identify(self) -> Identity | None:
        """Return what the picture is remembered by once it was found intact; None if its file cannot be seen."""
        return identify(self.run / self.file, self.offset, self.sha256)

    @property
    def end(self) -> int:
        """The offset behind its last byte in frames.raw."""
        return self.offset + math.prod(self.shape or (0,))

    @property
    def _place(self) -> str:
        path = self.run / self.file
        return str(path) if self.shape is None else f"{path} from byte {self.offset}"

    def _require_hash(self, content: bytes) -> None:
        if hashlib.sha256(content).hexdigest() != self.sha256:
            raise RecordError(f"{self._place} is damaged: its SHA-256 does not fit {FRAME_LINES}", COPY_HINT)

    def _read_content(self) -> bytes:
        path = inside(self.run, self.file)
        try:
            if self.shape is None:
                return read_file(path, MAX_PICTURE_BYTES)
            with open_file(path) as file:
                file.seek(self.offset)
                return file.read(self.end - self.offset)
        except OSError as error:
            raise RecordError(f"cannot read {path}: {error.strerror}", COPY_HINT) from error


def locate_picture(run: Path, line: Mapping[str, object]) -> RecordedPicture | None:
    """Return the place of the picture of a line of frames.jsonl; None if the line gives no valid place."""
    file, sha256, frame = line.get("file"), line.get("sha256"), line.get("frame")
    if not isinstance(sha256, str) or not isinstance(frame, int) or isinstance(frame, bool):
        return None
    if file == picture_file(frame):
        return RecordedPicture(run, picture_file(frame), sha256)
    offset, shape = line.get("offset"), line.get("shape")
    if file != RAW_PICTURES or not isinstance(offset, int) or not isinstance(shape, list) or offset < 0:
        return None
    if len(shape) not in {2, 3} or not all(isinstance(side, int) and side > 0 for side in shape):
        return None
    return RecordedPicture(run, RAW_PICTURES, sha256, offset, tuple(shape))


def count_pictures(run: Path) -> int:
    """Return how many pictures frames.jsonl lists, without decoding it; 0 if it cannot be read."""
    try:
        return read_file(inside(run, FRAME_LINES), MAX_LOG_BYTES).count(b"\n")
    except (OSError, RecordError):
        return 0


def measure_raw_pictures(run: Path) -> int:
    """Return the length of frames.raw; 0 without one."""
    path = inside(run, RAW_PICTURES)
    return path.stat().st_size if path.is_file() else 0


def measure_listed_pictures(run: Path, lines: Iterable[Mapping[str, object]]) -> int:
    """Return how many bytes of frames.raw the lines of frames.jsonl cover."""
    pictures = (locate_picture(run, line) for line in lines)
    return max((picture.end for picture in pictures if picture is not None), default=0)


def _require_picture(image: Picture) -> Picture:
    grey_or_bgr = image.ndim == 2 or (image.ndim == 3 and image.shape[2] == 3)
    if image.dtype != np.uint8 or not grey_or_bgr or image.size == 0:
        raise InputError(
            f"a picture is a uint8 array (H, W) or (H, W, 3); got {image.dtype} {image.shape}",
            "set the camera to 8-bit grey or BGR",
        )
    return image
