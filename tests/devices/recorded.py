"""Recorded pictures: each says by its grey level which it is."""

from pathlib import Path

import cv2
import numpy as np

from labrig.devices.camera import Picture
from tests.devices.captures import SIZE_PX


def draw_numbered_picture(number: int) -> Picture:
    """Return the picture with a number."""
    picture = np.full(SIZE_PX[::-1], 10 + 5 * number, np.uint8)
    picture[:8] = 0
    return picture


def number_in(image: Picture) -> int:
    """Return the number of a picture."""
    return round((float(image[-8:].mean()) - 10) / 5)


def write_pictures(folder: Path, count: int) -> Path:
    """Write pictures 1.png, 2.png, ... into a new folder."""
    folder.mkdir()
    for number in range(count):
        cv2.imwrite(str(folder / f"{number + 1}.png"), draw_numbered_picture(number))
    return folder
