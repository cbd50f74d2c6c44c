"""Pictures from files: what is read unchanged, and what is refused."""

import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest

from labrig.errors import PictureError
from labrig.vision.picture import number_order, read_picture, size_of


@pytest.fixture
def grey():
    """Return a grey picture."""
    return np.random.default_rng(0).integers(0, 256, (30, 40), dtype=np.uint8)


@pytest.fixture
def colour():
    """Return a picture in colour."""
    return np.random.default_rng(1).integers(0, 256, (30, 40, 3), dtype=np.uint8)


def save(path, image):
    """Write a picture and return its path."""
    assert cv2.imwrite(str(path), image)
    return path


@pytest.mark.parametrize("name", ["grey", "colour"])
def test_reads_pixels_as_they_were_saved(name, tmp_path, request):
    """A PNG comes back bit for bit, grey as (H, W) and colour as blue-green-red."""
    image = request.getfixturevalue(name)
    read = read_picture(save(tmp_path / "picture.png", image))
    assert read.dtype == np.uint8
    assert (read == image).all()


def test_drops_the_alpha_channel(colour, tmp_path):
    """Transparency is not light, so only the colours are kept."""
    with_alpha = np.dstack((colour, np.full(colour.shape[:2], 7, dtype=np.uint8)))
    assert (read_picture(save(tmp_path / "alpha.png", with_alpha)) == colour).all()


def exif(orientation, order):
    """Return EXIF data with this orientation, of either byte order."""
    start = b"MM\x00*" if order == ">" else b"II*\x00"
    entry = struct.pack(f"{order}HHIHH", 0x0112, 3, 1, orientation, 0)
    return start + struct.pack(f"{order}IH", 8, 1) + entry + bytes(4)


def save_oriented(path, image, orientation, order):
    """Return the path of a JPEG or PNG with an EXIF orientation."""
    plain = save(path, image).read_bytes()
    tags = exif(orientation, order)
    if path.suffix == ".jpg":
        body = b"Exif\x00\x00" + tags
        path.write_bytes(plain[:2] + b"\xff\xe1" + struct.pack(">H", len(body) + 2) + body + plain[2:])
    else:
        chunk = b"eXIf" + tags
        whole = struct.pack(">I", len(tags)) + chunk + struct.pack(">I", zlib.crc32(chunk))
        path.write_bytes(plain[:33] + whole + plain[33:])
    return path


@pytest.mark.parametrize(("suffix", "order"), [("jpg", ">"), ("jpg", "<"), ("png", ">")])
def test_refuses_a_picture_that_is_to_be_shown_turned(suffix, order, grey, tmp_path):
    """Pixels that a person reads in a viewer would not be the sensor's."""
    turned = save_oriented(tmp_path / f"turned.{suffix}", grey, 6, order)
    with pytest.raises(PictureError, match=rf"turned\.{suffix} is to be shown turned or mirrored") as caught:
        read_picture(turned)
    assert "without that mark" in caught.value.hint
    upright = save_oriented(tmp_path / f"upright.{suffix}", grey, 1, order)
    assert size_of(read_picture(upright)) == (40, 30)


def test_malformed_marks_of_orientation_turn_nothing(grey, tmp_path):
    """A directory of tags that points outside the file is ignored, and the picture is read."""
    path = save(tmp_path / "picture.jpg", grey)
    plain = path.read_bytes()
    body = b"Exif\x00\x00MM\x00*" + struct.pack(">I", 2**31)
    path.write_bytes(plain[:2] + b"\xff\xe1" + struct.pack(">H", len(body) + 2) + body + plain[2:])
    assert size_of(read_picture(path)) == (40, 30)


@pytest.mark.parametrize("suffix", ["png", "jpg"])
@pytest.mark.parametrize("share", [0.3, 0.9])
def test_refuses_a_truncated_picture(suffix, share, colour, tmp_path):
    """A truncated picture is refused, although decoders would fill it with grey."""
    whole = save(tmp_path / f"whole.{suffix}", colour).read_bytes()
    torn = tmp_path / f"torn.{suffix}"
    torn.write_bytes(whole[: int(share * len(whole))])
    with pytest.raises(PictureError, match=rf"torn\.{suffix} is truncated"):
        read_picture(torn)


def test_refuses_a_damaged_png(grey, tmp_path):
    """A flipped bit fails the chunk's checksum."""
    path = save(tmp_path / "picture.png", grey)
    data = bytearray(path.read_bytes())
    data[60] ^= 1
    path.write_bytes(data)
    with pytest.raises(PictureError, match="damaged"):
        read_picture(path)


def test_refuses_sixteen_bits(grey, tmp_path):
    """Depths other than eight bits are not scaled by guess."""
    path = save(tmp_path / "deep.png", grey.astype(np.uint16) * 257)
    with pytest.raises(PictureError, match=r"deep\.png has pixels of kind I;16") as caught:
        read_picture(path)
    assert "8-bit" in caught.value.hint


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".bmp", ".tif"])
def test_refuses_a_picture_of_too_many_pixels_undecoded(suffix, grey, tmp_path):
    """A small file can state a huge size; the header is read before memory is taken."""
    path = save(tmp_path / f"bomb{suffix}", grey)
    data = bytearray(path.read_bytes())
    if suffix == ".png":
        data[16:24] = struct.pack(">II", 30_000, 30_000)
        data[29:33] = struct.pack(">I", zlib.crc32(data[12:29]))
    elif suffix == ".jpg":
        start = data.index(b"\xff\xc0")
        data[start + 5 : start + 9] = struct.pack(">HH", 30_000, 30_000)
    elif suffix == ".bmp":
        data[18:26] = struct.pack("<ii", 30_000, -30_000)
    else:
        for tag in (0x100, 0x101):
            start = data.index(struct.pack("<HHI", tag, 3, 1))
            data[start + 8 : start + 10] = struct.pack("<H", 30_000)
    path.write_bytes(data)
    with pytest.raises(PictureError, match="30000 x 30000 pixels, at most 67108864 are read"):
        read_picture(path)


def test_numbers_in_names_are_those_of_decimal_digits():
    """A superscript is no digit of a number; picture2 still comes before picture10."""
    names = ["picture10.png", "10²5.png", "picture2.png"]
    assert sorted(map(Path, names), key=number_order) == [Path(names[1]), Path(names[2]), Path(names[0])]


def test_refuses_what_is_no_picture(tmp_path):
    """Missing files, folders, empty files and text are refused, each with its reason."""
    (tmp_path / "notes.jpg").write_text("not a picture")
    (tmp_path / "empty.png").touch()
    for name, message in [
        ("gone.png", "does not exist"),
        (".", "folder"),
        ("empty.png", "empty"),
        ("notes.jpg", "no picture"),
    ]:
        with pytest.raises(PictureError, match=message) as caught:
            read_picture(tmp_path / name)
        assert caught.value.hint
