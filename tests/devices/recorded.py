"""Recorded pictures: each says by its grey level which it is."""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from labrig.devices.camera import Picture
from tests.devices.captures import SIZE_PX

FILM_RATE_HZ = 20.0


def draw_numbered_picture(number: int) -> Picture:
    """Return the picture with a number."""
    picture = np.full(SIZE_PX[::-1], 10 + 5 * number, np.uint8)
    picture[:8] = 0
    return picture


def number_in(image: Picture) -> int:
    """Return the number of a picture, which a video may have changed by a grey level or two."""
    return round((float(image[-8:].mean()) - 10) / 5)


def write_pictures(folder: Path, count: int) -> Path:
    """Write pictures 1.png, 2.png, ... into a new folder."""
    folder.mkdir()
    for number in range(count):
        cv2.imwrite(str(folder / f"{number + 1}.png"), draw_numbered_picture(number))
    return folder


def write_sidecar(folder: Path, times_s: Sequence[float]) -> None:
    """Write the times of such pictures."""
    lines = [f"{number}.png,{time_s}" for number, time_s in enumerate(times_s, start=1)]
    (folder / "times.csv").write_text("\n".join(["picture,t_s", *lines, ""]), encoding="utf-8")


def write_film(path: Path, count: int) -> Path:
    """Write a video of such pictures."""
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"FFV1"), FILM_RATE_HZ, SIZE_PX, isColor=True)
    for number in range(count):
        writer.write(cv2.cvtColor(draw_numbered_picture(number), cv2.COLOR_GRAY2BGR))
    writer.release()
    return path
