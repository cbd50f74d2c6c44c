"""Pictures of a camera over HTTP, each with its time of exposure on this computer's clock."""

import time
from collections.abc import Callable
from typing import Protocol

from labrig.clock import Clock
from labrig.devices.mjpeg.parts import Part
from labrig.devices.stream_source import Dropped, Received
from labrig.errors import PictureError
from labrig.vision.picture import decode_picture


class Parts(Protocol):
    """Where the parts come from: `PartReader`."""

    def read_part(self) -> Part:
        """Wait for the next part. Raises `CameraError` when none can follow."""

    def close(self) -> None:
        """Close it."""


class StampedPictures:
    """The pictures of a stream, each with the time of its stamp.

    Parameters
    ----------
    parts : Parts
        The stream.
    address : str
        Its name in messages.
    clock : Clock
        Tells the calendar time, with which the stamps are compared.
    latency_s : float
        Greatest age of a picture on its arrival [s].
    stamp_error_s : float
        How far a stamp may be wrong; a picture may come so long before its stamp [s].
    monotonic_s : callable
        The computer's monotonic time [s].
    """

    def __init__(
        self,
        parts: Parts,
        address: str,
        clock: Clock,
        *,
        latency_s: float,
        stamp_error_s: float,
        monotonic_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self.description = f"camera {address}"
        self._parts = parts
        self._clock = clock
        self._latency_s = latency_s
        self._stamp_error_s = stamp_error_s
        self._monotonic_s = monotonic_s
        self._last_utc_s = 0.0

    def receive(self) -> Received | Dropped:
        """Wait for the next picture. Raises `CameraError` when none can follow.

        A late one is dropped before it is decoded, so that a computer that has fallen behind catches up.
        """
        part = self._parts.read_part()
        arrived_s, age_s = self._monotonic_s(), self._clock.utc().timestamp() - part.exposed_utc_s
        reason = self._find_fault(part.exposed_utc_s, age_s)
        if reason:
            return Dropped(reason)
        self._last_utc_s = part.exposed_utc_s
        try:
            return Received(arrived_s - age_s, decode_picture(part.jpeg, "it"))
        except PictureError as error:
            return Dropped(error.message)

    def _find_fault(self, exposed_utc_s: float, age_s: float) -> str:
        """Return why a picture with this stamp cannot be used; empty if it can."""
        if age_s > self._latency_s:
            return f"it was {age_s:.3f} s old by its X-Timestamp when it came, latency_s is {self._latency_s:g} s"
        if age_s < -self._stamp_error_s:
            return (
                f"its X-Timestamp is {-age_s:.3f} s after it came, stamp_error_s is {self._stamp_error_s:g} s"
            )
        if exposed_utc_s <= self._last_utc_s:
            return f"its X-Timestamp {exposed_utc_s:.6f} is not later than that of one before, {self._last_utc_s:.6f}"
        return ""

    def close(self) -> None:
        """Close the stream."""
        self._parts.close()
