"""Pictures from files: what is read unchanged, and what is refused."""

import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest

from labrig.errors import PictureError
from labrig.vision.picture import number_order, read_picture, size_of

GREY = np.random.default_rng(0).integers(0, 256, (30, 40), dtype=np.uint8)
COLOUR = np.random.default_rng(1).integers(0, 256, (30, 40, 3), dtype=np.uint8)


def save(path, image):
    """Write a picture and return its path."""
    assert cv2.imwrite(str(path), image)
    return path


def test_reads_pixels_as_they_were_saved(tmp_path):
    """A PNG comes back bit for bit, grey as (H, W) and colour as blue-green-red, without transparency."""
    opacity = np.full((*GREY.shape, 1), 7, dtype=np.uint8)
    for saved, kept in ((GREY, GREY), (COLOUR, COLOUR), (np.dstack((COLOUR, opacity)), COLOUR)):
        read = read_picture(save(tmp_path / "picture.png", saved))
        assert read.dtype == np.uint8
        assert np.array_equal(read, kept)


def save_oriented(path, image, orientation, order):
    """Return the path of a JPEG or PNG with an EXIF orientation, of either byte order."""
    plain = save(path, image).read_bytes()
    tags = (b"MM\x00*" if order == ">" else b"II*\x00") + struct.pack(
        f"{order}IHHHIHHI", 8, 1, 0x0112, 3, 1, orientation, 0, 0
    )
    if path.suffix == ".jpg":
        body = b"Exif\x00\x00" + tags
        path.write_bytes(plain[:2] + b"\xff\xe1" + struct.pack(">H", len(body) + 2) + body + plain[2:])
    else:
        chunk = b"eXIf" + tags
        whole = struct.pack(">I", len(tags)) + chunk + struct.pack(">I", zlib.crc32(chunk))
        path.write_bytes(plain[:33] + whole + plain[33:])
    return path


@pytest.mark.parametrize(("suffix", "order"), [("jpg", ">"), ("jpg", "<"), ("png", ">")])
def test_refuses_a_picture_that_is_to_be_shown_turned(suffix, order, tmp_path):
    """Pixels that a person reads in a viewer would not be the sensor's."""
    with pytest.raises(PictureError, match=rf"turned\.{suffix} is to be shown turned or mirrored") as caught:
        read_picture(save_oriented(tmp_path / f"turned.{suffix}", GREY, 6, order))
    assert "without that mark" in caught.value.hint
    assert size_of(read_picture(save_oriented(tmp_path / f"upright.{suffix}", GREY, 1, order))) == (40, 30)


@pytest.mark.parametrize(
    ("name", "spoil", "message"),
    [
        ("torn.png", lambda data: data[: len(data) // 3], r"torn\.png is truncated"),
        ("torn.png", lambda data: data[: 9 * len(data) // 10], r"torn\.png is truncated"),
        ("torn.jpg", lambda data: data[: len(data) // 3], r"torn\.jpg is truncated"),
        ("torn.jpg", lambda data: data[: 9 * len(data) // 10], r"torn\.jpg is truncated"),
        ("flipped.png", lambda data: data[:60] + bytes([data[60] ^ 1]) + data[61:], "damaged"),
        ("empty.png", lambda _: b"", "is empty"),
        ("notes.jpg", lambda _: b"not a picture", "no picture"),
    ],
)
def test_refuses_a_damaged_picture(name, spoil, message, tmp_path):
    """A truncated picture, which decoders would fill with grey, a flipped bit, and what is no picture."""
    path = save(tmp_path / name, COLOUR)
    path.write_bytes(spoil(path.read_bytes()))
    with pytest.raises(PictureError, match=message) as caught:
        read_picture(path)
    assert caught.value.hint


def test_refuses_what_is_no_file_and_sixteen_bits(tmp_path):
    """Missing files, folders, and depths other than eight bits, which are not scaled by guess."""
    save(tmp_path / "deep.png", GREY.astype(np.uint16) * 257)
    names = {"gone.png": "does not exist", ".": "folder", "deep.png": r"deep\.png has pixels of kind I;16"}
    for name, message in names.items():
        with pytest.raises(PictureError, match=message):
            read_picture(tmp_path / name)


def test_refuses_a_picture_of_too_many_pixels_undecoded(tmp_path):
    """A small file can state a huge size; the header is read before memory is taken."""
    path = save(tmp_path / "bomb.png", GREY)
    data = bytearray(path.read_bytes())
    data[16:24] = struct.pack(">II", 30_000, 30_000)
    data[29:33] = struct.pack(">I", zlib.crc32(data[12:29]))
    path.write_bytes(data)
    with pytest.raises(PictureError, match="30000 x 30000 pixels, at most 67108864 are read"):
        read_picture(path)


def test_numbers_in_names_are_those_of_decimal_digits():
    """A superscript is no digit of a number; picture2 still comes before picture10."""
    names = ["picture10.png", "10²5.png", "picture2.png"]
    assert sorted(map(Path, names), key=number_order) == [Path(names[1]), Path(names[2]), Path(names[0])]
