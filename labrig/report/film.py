"""Films of recorded pictures with lines over them: MP4 with VP9, which browsers and OpenCV's own writer have."""

from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from labrig.errors import DiskError, RecordError
from labrig.record.reader import Run
from labrig.report.film_pictures import Colour, Film, FilmPicture
from labrig.vision.picture import Picture, size_of

_PICTURES_PER_S = 10.0
_HELD_PICTURES = 20
"""For so long the last picture stands still."""
_WIDEST_PX = 960
"""Wider pictures take VP9 seconds each, and megabytes."""
_STRIP_PX = 40
_FONT, _TEXT_SCALE, _TEXT_PX = cv2.FONT_HERSHEY_SIMPLEX, 0.6, 12
_WHITE: Colour = (255, 255, 255)
# Lines are drawn at a sixteenth of a pixel.
_SHIFT = 4
_SMOOTH = {"lineType": cv2.LINE_AA, "shift": _SHIFT}


def write_film(folder: Path, run: Run, film: Film, report: Callable[[float, str], None]) -> None:
    """Write a film as NAME.mp4, ten pictures a second; pictures that cannot be read are left out.

    `report` is told how many pictures are drawn, and what of.

    Raises
    ------
    DiskError
        When the file does not hold what was written.
    RecordError
        When no picture can be read.
    """
    path = folder / f"{film.name}.mp4"
    written = 0
    writer = cv2.VideoWriter()
    for image in _draw_all(run, film):
        if not writer.isOpened():
            height, width = image.shape[:2]
            writer.open(str(path), cv2.VideoWriter.fourcc(*"vp09"), _PICTURES_PER_S, (width, height))
        writer.write(image)
        written += 1
        report(written, f"picture {written}")
    if not written:
        raise RecordError(f"no picture of {film.name} can be read", "see: labrig runs check")
    for _ in range(_HELD_PICTURES):
        writer.write(image)
    writer.release()
    # The writer reports neither a full disk nor a codec that it lacks.
    if cv2.VideoCapture(str(path)).get(cv2.CAP_PROP_FRAME_COUNT) != written + _HELD_PICTURES:
        raise DiskError(f"cannot write {path}", "free space on the disk; nothing else needs the film")


def _draw_all(run: Run, film: Film) -> Iterator[NDArray[np.uint8]]:
    for picture in film.pictures:
        with suppress(RecordError):
            yield draw_film_picture(run.read_frame(picture.frame), picture)


def draw_film_picture(image: Picture, picture: FilmPicture) -> NDArray[np.uint8]:
    """Return a picture (H, W, 3; BGR) of even size with its lines, and under it a strip with caption and key."""
    width, height = size_of(image)
    scale = min(1.0, _WIDEST_PX / width)
    size = tuple(2 * max(1, round(scale * length / 2)) for length in (width, height))
    smaller = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    coloured = cv2.cvtColor(smaller, cv2.COLOR_GRAY2BGR) if smaller.ndim == 2 else smaller
    for stroke in picture.strokes:
        corners = np.round(scale * np.asarray(stroke.px) * 2**_SHIFT).astype(np.int32)
        colour, wide_px = stroke.colour[::-1], stroke.width_px
        cv2.polylines(coloured, [corners], isClosed=False, color=colour, thickness=wide_px, **_SMOOTH)
    drawn = np.pad(np.asarray(coloured, dtype=np.uint8), ((0, _STRIP_PX), (0, 0), (0, 0)))
    _write_strip(drawn, picture)
    return drawn


def _write_strip(drawn: NDArray[np.uint8], picture: FilmPicture) -> None:
    """Write the caption, and behind it what each line is, in its colour; what has no room is cut off."""
    names = {stroke.name: stroke.colour for stroke in picture.strokes if stroke.name}
    place = [_TEXT_PX, drawn.shape[0] - _STRIP_PX + 2 * _TEXT_PX + 2]
    for text, colour in {picture.caption: _WHITE, **names}.items():
        cv2.putText(drawn, text, place, _FONT, _TEXT_SCALE, colour[::-1], 1, cv2.LINE_AA)
        place[0] += cv2.getTextSize(text, _FONT, _TEXT_SCALE, 1)[0][0] + 2 * _TEXT_PX
