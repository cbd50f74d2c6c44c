"""A camera over HTTP as a kind of camera."""

from labrig.devices.camera_kind import CameraContext, CameraKind
from labrig.devices.mjpeg.parts import PartReader
from labrig.devices.mjpeg.receiver import StampedPictures
from labrig.devices.mjpeg.settings import MjpegCameraDescription
from labrig.devices.stream_source import STREAM_TIMEOUT_S, StreamSource


class MjpegCamera(CameraKind[MjpegCameraDescription]):
    """A camera that sends MJPEG over HTTP with times of exposure."""

    name = "mjpeg"
    settings = MjpegCameraDescription

    def open(self, section: MjpegCameraDescription, context: CameraContext) -> StreamSource:
        """Open the stream, and wait for a picture that can be used.

        Raises
        ------
        CameraError
            When none comes, or pictures come without times of exposure.
        """
        pictures = StampedPictures(
            PartReader(section.source, longest_bytes=section.longest_bytes, timeout_s=STREAM_TIMEOUT_S),
            section.address,
            context.clock,
            latency_s=section.latency_s,
            stamp_error_s=section.stamp_error_s,
        )
        source = StreamSource(pictures, context.clock, bound_s=section.stamp_error_s)
        source.wait_for_first()
        return source


CAMERA = MjpegCamera()
