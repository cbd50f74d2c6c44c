"""Pictures that cannot be measured as they are, made from one that can."""

import struct
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

Picture = NDArray[np.uint8]


def write_bad_pictures(good: Path, folder: Path) -> dict[str, Path]:
    """Write each kind of bad picture that `good` can be turned into; return them by what is wrong with them."""
    picture = np.asarray(cv2.imread(str(good), cv2.IMREAD_UNCHANGED), np.uint8)
    height, width = picture.shape[:2]
    made: dict[str, Callable[[], Path]] = {
        "16 bits": lambda: _save(folder / "deep.png", picture.astype(np.uint16) * 257),
        "turned by EXIF": lambda: _turn(folder / "turned.jpg", picture),
        "truncated": lambda: _cut(folder / "torn.png", good),
        "no picture": lambda: _text(folder / "notes.png"),
        "wrong size": lambda: _save(folder / "small.png", picture[: height // 2, : width // 2]),
        "all black": lambda: _save(folder / "black.png", np.zeros_like(picture)),
        "no needle": lambda: _save(folder / "none.png", _gel(picture)),
        "two needles": lambda: _save(
            folder / "two.png", np.minimum(picture, np.roll(picture, height // 4, axis=0))
        ),
        "needle out of the frame": lambda: _save(folder / "out.png", _shift(picture, 7 * width // 10)),
    }
    return {name: make() for name, make in made.items()}


def _save(path: Path, picture: NDArray[np.unsignedinteger]) -> Path:
    assert cv2.imwrite(str(path), picture)
    return path


def _gel(picture: Picture) -> Picture:
    return np.random.default_rng(0).integers(150, 160, picture.shape, dtype=np.uint8)


def _shift(picture: Picture, px: int) -> Picture:
    """Return the picture moved to the right, its left border repeated."""
    return np.hstack((np.repeat(picture[:, :1], px, axis=1), picture[:, :-px]))


def _turn(path: Path, picture: Picture) -> Path:
    data = _save(path, picture).read_bytes()
    tags = b"MM\x00*" + struct.pack(">IHHHIHHI", 8, 1, 0x0112, 3, 1, 6, 0, 0)
    body = b"Exif\x00\x00" + tags
    path.write_bytes(data[:2] + b"\xff\xe1" + struct.pack(">H", len(body) + 2) + body + data[2:])
    return path


def _cut(path: Path, good: Path) -> Path:
    data = good.read_bytes()
    path.write_bytes(data[: len(data) // 2])
    return path


def _text(path: Path) -> Path:
    path.write_text("no picture")
    return path
