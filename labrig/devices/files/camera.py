"""Recorded pictures as a kind of camera."""

from collections.abc import Iterator
from pathlib import Path

from labrig.devices.camera import Camera
from labrig.devices.camera_kind import CameraContext, CameraKind
from labrig.devices.check_result import CheckResult, CheckStatus
from labrig.devices.files.folder import PictureFolder, list_pictures, read_sidecar, require_rising
from labrig.devices.files.playback import PlaybackSource, RecordedPictures
from labrig.devices.files.settings import FilesCameraDescription
from labrig.devices.files.stream import ArrivingPictures, open_stream
from labrig.devices.files.video import VideoFile
from labrig.devices.stream_source import StreamSource
from labrig.errors import CameraError


class FilesCamera(CameraKind[FilesCameraDescription]):
    """Recorded pictures in place of a camera."""

    name = "files"
    settings = FilesCameraDescription

    def open(self, section: FilesCameraDescription, context: CameraContext) -> PlaybackSource | StreamSource:
        """Open the folder, the file or the stream.

        Raises
        ------
        CameraError
            When it cannot be read, or its times do not increase.
        """
        if section.is_stream:
            pictures = ArrivingPictures(open_stream(section.source, section.address), section.address)
            source = StreamSource(pictures, context.clock, bound_s=section.latency_s)
            source.wait_for_first()
            return source
        return PlaybackSource(
            _open_pictures(section, context.folder / section.source), context.clock, section.start_s
        )

    def check(self, section: FilesCameraDescription, camera: Camera) -> Iterator[CheckResult]:
        """Yield that pictures arrive and are recorded ones."""
        height, width = camera.capture().image.shape[:2]
        value = f"{width}x{height} px, recorded pictures of {section.address}: they never steer"
        yield CheckResult("camera picture", CheckStatus.PASS, value)


def _open_pictures(section: FilesCameraDescription, path: Path) -> RecordedPictures:
    if not path.is_dir():
        if section.times in {"sidecar", "modified"}:
            raise CameraError(
                f"{path} is not a folder, and times is {section.times}", "write times: null, or rate"
            )
        return VideoFile(path, section.rate_hz if section.times == "rate" else None)
    paths = list_pictures(path)
    times_s = _find_times(section, path, paths)
    if times_s is not None:
        require_rising(paths, times_s)
    return PictureFolder(path, paths, times_s)


def _find_times(section: FilesCameraDescription, folder: Path, paths: tuple[Path, ...]) -> list[float] | None:
    match section.times:
        case "rate":
            return [number / section.rate_hz for number in range(len(paths))]
        case "sidecar":
            return read_sidecar(folder, paths)
        case "modified":
            return [path.stat().st_mtime for path in paths]
    return None


CAMERA = FilesCamera()
