"""files: recorded pictures in place of a camera, by `driver: files`; a folder or a video file.

What is decided here
--------------------
- Recorded pictures do not show what the needle does now. They run the path of a bench without a camera and play
  a film through a protocol. With real drives, an experiment whose pictures decide motion is refused.
- Pictures with times are played in rig time from the first read on: a read waits for the first picture that is not
  older than its command. A folder without times gives its next picture for each read.
- Only regular files are read, and FFmpeg alone opens videos: no address, option, pipeline or list of files.
"""

import csv
import io
import math
import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Annotated, ClassVar, Literal

import cv2
import numpy as np
from pydantic import AfterValidator, Field

from labrig.clock import Clock
from labrig.devices.camera import Camera, CameraContext, CameraKind, Exposure, Picture
from labrig.devices.camera_settings import CameraDescription, RigKind, Setting
from labrig.devices.check_result import CheckResult, CheckStatus
from labrig.errors import CameraError, PictureError
from labrig.input_file import open_file, read_file
from labrig.vision.picture import PICTURE_SUFFIXES, number_order, read_picture, size_of

_SIDECAR = "times.csv"
_COLUMNS = ["picture", "t_s"]
_HEAD_BYTES = 4096
_MICROSECOND_S = 1e-6
_LONGEST_GAP_S = 5.0
"""The longest wait for a picture."""


def _check_source(source: str) -> str:
    if "://" in source:
        raise ValueError("labrig takes no pictures over the network; name a folder or a video file")
    return source


class FilesCameraDescription(CameraDescription):
    """Recorded pictures in place of a camera: a folder or a video file. They never steer."""

    rig_kinds: ClassVar[frozenset[RigKind]] = frozenset({"simulated", "bench"})
    recorded: ClassVar[bool] = True

    driver: Literal["files"] = Field(description="files: recorded pictures in place of a camera.")
    source: Annotated[str, Field(min_length=1, max_length=1000), AfterValidator(_check_source)] = Field(
        description="Folder of pictures or video file, relative to the rig file."
    )
    times: Literal["rate", "sidecar", "modified"] | None = Field(
        None,
        description="Times of the pictures. rate: one every 1 / rate_hz; sidecar: from times.csv in the folder, with "
        "the columns picture and t_s; modified: the modification time of each file. null: a video has its own times; a "
        "folder gives its next picture at each request.",
    )
    start_s: Annotated[float, Field(ge=0, le=1e6)] = Field(
        0.0, description="Time of the picture that a run takes first, counted from the first picture [s]."
    )

    @property
    def address(self) -> str:
        """The source."""
        return self.source

    def settings(self) -> dict[str, Setting]:
        """Return the required size of the pictures; they have a rate of their own."""
        return {"width_px": self.width_px, "height_px": self.height_px}


@dataclass(frozen=True)
class Recording:
    """Recorded pictures in order, each taken once.

    Attributes
    ----------
    description : str
        Their name in messages.
    size_px : tuple of int
        Width and height of the first one.
    pictures : iterator
        Time of each picture [s after the first], or None if they have no times, and what reads it.
    close : callable
        Closes the file.
    """

    description: str
    size_px: tuple[int, int]
    pictures: Iterator[tuple[float | None, Callable[[], Picture]]]
    close: Callable[[], None] = lambda: None


class PlaybackSource:
    """Recorded pictures, played in rig time from the first read on.

    Parameters
    ----------
    recording : Recording
        The pictures.
    clock : Clock
        Rig time.
    start_s : float
        Time of the first read, counted from the first picture [s].
    """

    def __init__(self, recording: Recording, clock: Clock, start_s: float) -> None:
        self.exposures = 0
        self.close = recording.close
        self._recording = recording
        self._clock = clock
        self._start_s = start_s
        self._zero_s: float | None = None
        self._last_s: float | None = None
        self._size = dict(zip(("width_px", "height_px"), map(float, recording.size_px), strict=True))

    def set(self, name: str, value: Setting) -> None:
        """Do nothing: recorded pictures have no settings."""

    def get(self, name: str) -> Setting | None:
        """Return the width or height of the pictures."""
        return self._size.get(name)

    def read(self) -> Exposure:
        """Return the next picture; if they have times, the first one not older than now.

        Raises
        ------
        CameraError
            When no picture is left, or the next one is too much later.
        """
        now_s, what = self._clock.now_s(), self._recording.description
        if self._zero_s is None:
            self._zero_s = now_s - self._start_s
        from_s = now_s - self._zero_s - _MICROSECOND_S
        for time_s, load in self._recording.pictures:
            self.exposures += 1
            if time_s is None:
                return Exposure(load())
            if time_s < from_s:
                continue
            if time_s - from_s > _LONGEST_GAP_S:
                raise CameraError(
                    f"{what}: the next picture is at {time_s:.3f} s, {from_s:.3f} s was requested",
                    f"labrig waits at most {_LONGEST_GAP_S:g} s for a picture",
                )
            self._last_s = time_s
            return Exposure(load(), self._zero_s + time_s, t_bound_s=0.0)
        end = "" if self._last_s is None else f", the last one taken at {self._last_s:.3f} s"
        raise CameraError(
            f"the pictures have ended: {what}, {self.exposures} taken or skipped{end}",
            "record more pictures, or take fewer: labrig check PROTOCOL says how many a run takes",
        )


class FilesCamera(CameraKind[FilesCameraDescription]):
    """Recorded pictures in place of a camera."""

    name = "files"
    settings = FilesCameraDescription

    def open(self, section: FilesCameraDescription, context: CameraContext) -> PlaybackSource:
        """Open the folder or the file.

        Raises
        ------
        CameraError
            When it cannot be read, or its times do not increase.
        """
        path = context.folder / section.source
        recording = _open_folder(section, path) if path.is_dir() else _open_video(section, path)
        return PlaybackSource(recording, context.clock, section.start_s)

    def check(self, section: FilesCameraDescription, camera: Camera) -> Iterator[CheckResult]:
        """Yield that pictures arrive and are recorded ones."""
        height, width = camera.capture().image.shape[:2]
        value = f"{width}x{height} px, recorded pictures of {section.address}: they never steer"
        yield CheckResult("camera picture", CheckStatus.PASS, value)


CAMERA = FilesCamera()


# A folder


def _open_folder(section: FilesCameraDescription, folder: Path) -> Recording:
    """Return the pictures of a folder, picture2 before picture10; nothing outside it is read."""
    paths = _list_pictures(folder)
    times_s: list[float] | None = None
    match section.times:
        case "rate":
            times_s = [number / section.rate_hz for number in range(len(paths))]
        case "sidecar":
            times_s = read_sidecar(folder, paths)
        case "modified":
            times_s = [path.stat().st_mtime for path in paths]
    if times_s is not None:
        _require_rising(paths, times_s)
    return Recording(
        f"{len(paths)} recorded pictures of folder {folder}",
        size_of(_read(paths[0])),
        (
            (None if times_s is None else times_s[index] - times_s[0], partial(_read, path))
            for index, path in enumerate(paths)
        ),
    )


def _list_pictures(folder: Path) -> tuple[Path, ...]:
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


def read_sidecar(folder: Path, paths: Iterable[Path]) -> list[float]:
    """Return the time [s] of each picture from `times.csv`.

    Raises
    ------
    CameraError
        When the file cannot be read, a picture has no time or two times, or a named picture is not in the folder.
    """
    file, names = folder / _SIDECAR, [path.name for path in paths]
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
        where = f"{file}:{number}"
        try:
            name, text = row
            time_s = float(text)
        except ValueError as error:
            wrong = f"{where}: {','.join(row)!r} is not a picture with its time"
            raise CameraError(wrong, "write 1.png,0.04") from error
        if not math.isfinite(time_s):
            raise CameraError(f"{where}: the time of {name} is {text}", "write seconds")
        if name not in names or name in times_s:
            says = "is named twice" if name in times_s else "is not in the folder"
            raise CameraError(f"{where}: picture {name!r} {says}", "one line for each picture")
        times_s[name] = time_s
    if missing := [name for name in names if name not in times_s]:
        raise CameraError(f"{file} has no time for {missing[0]}", "one line for each picture")
    return [times_s[name] for name in names]


def _require_rising(paths: Sequence[Path], times_s: Sequence[float]) -> None:
    for (first, early_s), (second, late_s) in pairwise(zip(paths, times_s, strict=True)):
        if late_s <= early_s:
            raise CameraError(
                f"{second.name} is at {late_s:.6f} s, not later than {first.name} at {early_s:.6f} s",
                "write times: rate if the pictures have no times of their own, or rename them in order of time",
            )


def _read(path: Path) -> Picture:
    try:
        return read_picture(path)
    except PictureError as error:
        raise CameraError(error.message, error.hint) from error


# A video


def _open_video(section: FilesCameraDescription, path: Path) -> Recording:
    """Return the pictures of a video: a regular file, and not a list of other files, which is text."""
    if section.times in {"sidecar", "modified"}:
        raise CameraError(
            f"{path} is not a folder, and times is {section.times}", "write times: null, or rate"
        )
    try:
        with open_file(path) as file:
            head = file.read(_HEAD_BYTES)
    except OSError as error:
        raise CameraError(f"{path} cannot be read: {error.strerror}", "check camera.source") from error
    if b"\0" not in head:
        raise CameraError(f"{path} is text or empty, expected a video", "name the video itself, not a list")
    capture = cv2.VideoCapture(str(path.resolve()), cv2.CAP_FFMPEG)
    if not capture.isOpened():
        raise CameraError(
            f"{path} is not a video that OpenCV can open", "convert it to MJPEG in .avi, or to .mp4"
        )
    size = (int(capture.get(cv2.CAP_PROP_FRAME_WIDTH)), int(capture.get(cv2.CAP_PROP_FRAME_HEIGHT)))
    rate_hz = section.rate_hz if section.times == "rate" else None
    pictures = _play(capture, path, rate_hz)
    return Recording(f"recorded pictures of video {path}", size, pictures, capture.release)


def _play(
    capture: cv2.VideoCapture, path: Path, rate_hz: float | None
) -> Iterator[tuple[float, Callable[[], Picture]]]:
    """Yield the pictures of a video with the times in the file, or with those of a rate."""
    last_s, number = -1.0, 0
    while capture.grab():
        time_s = capture.get(cv2.CAP_PROP_POS_MSEC) / 1000 if rate_hz is None else number / rate_hz
        if time_s <= last_s:
            raise CameraError(
                f"picture {number} of {path} is at {time_s:.6f} s, not later than the one before it",
                "write times: rate, and the rate of the camera as rate_hz",
            )
        last_s, number = time_s, number + 1
        yield time_s, partial(_decode, capture, path, time_s)


def _decode(capture: cv2.VideoCapture, path: Path, time_s: float) -> Picture:
    ok, image = capture.retrieve()
    if not ok:
        raise CameraError(
            f"the picture of {path} at {time_s:.3f} s cannot be decoded", "convert the video again"
        )
    return np.asarray(image, np.uint8)
