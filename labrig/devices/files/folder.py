"""A folder of pictures, in the order of the numbers in their names, and their times."""

import csv
import io
import math
import os
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

from labrig.devices.camera import Picture
from labrig.errors import CameraError, PictureError
from labrig.input_file import read_file
from labrig.vision.picture import MAX_PICTURE_BYTES, PICTURE_SUFFIXES, number_order, read_picture, size_of

SIDECAR = "times.csv"
_COLUMNS = ["picture", "t_s"]


class PictureFolder:
    """Pictures of a folder, each taken once.

    Parameters
    ----------
    folder : Path
        The folder; nothing outside it is read.
    times_s : sequence of float or None
        Time of each picture [s], increasing; None if they have no times.

    Raises
    ------
    CameraError
        When the folder is missing, holds no picture, or a picture is not a regular file.
    """

    def __init__(self, folder: Path, paths: Sequence[Path], times_s: Sequence[float] | None) -> None:
        self.description = f"{len(paths)} recorded pictures of folder {folder}"
        self.passed = 0
        self._paths = paths
        self._times_s = times_s

    def size_px(self) -> tuple[int, int]:
        """Return width and height of the first picture."""
        return size_of(_read(self._paths[0]))

    def take(self, from_s: float) -> tuple[Picture, float | None] | None:
        """Return the next picture; if they have times, the next one of this time or later. None after the last."""
        while self.passed < len(self._paths):
            index = self.passed
            self.passed += 1
            time_s = None if self._times_s is None else self._times_s[index] - self._times_s[0]
            if time_s is None or time_s >= from_s:
                return _read(self._paths[index]), time_s
        return None

    def close(self) -> None:
        """Nothing to release."""


def list_pictures(folder: Path) -> tuple[Path, ...]:
    """Return the pictures of a folder, picture2 before picture10.

    Raises
    ------
    CameraError
        When the folder cannot be read or holds no picture, or a picture is a link or not a file.
    """
    try:
        with os.scandir(folder) as entries:
            found = [entry for entry in entries if Path(entry.name).suffix.lower() in PICTURE_SUFFIXES]
    except OSError as error:
        raise CameraError(
            f"folder {folder} cannot be read: {error.strerror}", "check camera.source"
        ) from error
    for entry in found:
        if not entry.is_file(follow_symlinks=False):
            raise CameraError(
                f"{entry.path} is not a regular file", "copy the picture itself into the folder"
            )
    if not found:
        raise CameraError(
            f"folder {folder} holds no picture", f"pictures end in {' '.join(sorted(PICTURE_SUFFIXES))}"
        )
    return tuple(sorted((Path(entry.path) for entry in found), key=number_order))


def read_sidecar(folder: Path, paths: Sequence[Path]) -> list[float]:
    """Return the time [s] of each picture from `times.csv`.

    Raises
    ------
    CameraError
        When the file cannot be read, a picture has no time or two times, or a named picture is not in the folder.
    """
    file, names = folder / SIDECAR, {path.name for path in paths}
    try:
        text = read_file(file).decode("utf-8")
        header, *rows = [*csv.reader(io.StringIO(text, newline=""))] or [[]]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise CameraError(
            f"{file} cannot be read: {error}",
            "it must have the header picture,t_s and a line for each picture",
        ) from error
    if header != _COLUMNS:
        raise CameraError(f"{file}:1: the columns are {header}", f"expected {','.join(_COLUMNS)}")
    times_s: dict[str, float] = {}
    for number, row in enumerate(rows, start=2):
        name, time_s = _parse_sidecar_line(f"{file}:{number}", row)
        if name not in names or name in times_s:
            says = "is named twice" if name in times_s else "is not in the folder"
            raise CameraError(f"{file}:{number}: picture {name!r} {says}", "one line for each picture")
        times_s[name] = time_s
    if missing := [path.name for path in paths if path.name not in times_s]:
        raise CameraError(f"{file} has no time for {missing[0]}", "one line for each picture")
    return [times_s[path.name] for path in paths]


def _parse_sidecar_line(where: str, row: Sequence[str]) -> tuple[str, float]:
    try:
        name, text = row
        time_s = float(text)
    except ValueError as error:
        raise CameraError(
            f"{where}: {','.join(row)!r} is not a picture with its time", "write 1.png,0.04"
        ) from error
    if not math.isfinite(time_s):
        raise CameraError(f"{where}: the time of {name} is {text}", "write seconds")
    return name, time_s


def require_rising(paths: Sequence[Path], times_s: Sequence[float]) -> None:
    """Refuse times that do not increase. Raises `CameraError`."""
    for (first, early_s), (second, late_s) in pairwise(zip(paths, times_s, strict=True)):
        if late_s <= early_s:
            raise CameraError(
                f"{second.name} is at {late_s:.6f} s, not later than {first.name} at {early_s:.6f} s",
                "write times: rate if the pictures have no times of their own, or rename them in order of time",
            )


def _read(path: Path) -> Picture:
    try:
        size = path.stat().st_size
        if size > MAX_PICTURE_BYTES:
            raise CameraError(
                f"{path} has {size} bytes, more than {MAX_PICTURE_BYTES}", "save a smaller picture"
            )
        return read_picture(path)
    except (OSError, PictureError) as error:
        raise CameraError(str(error), getattr(error, "hint", "")) from error
