"""A live stream as a source of pictures: a thread receives them and keeps the newest two."""

import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from threading import Condition, Thread
from typing import Protocol

from labrig.clock import Clock
from labrig.devices.camera import Exposure, Picture
from labrig.devices.camera_settings import Setting
from labrig.errors import CameraError

STREAM_TIMEOUT_S = 5.0
"""How long a stream may take to open, and to give a picture."""

_QUEUED_PICTURES = 2


@dataclass(frozen=True, eq=False)
class Received:
    """A picture, (H, W) or (H, W, 3) uint8, and its time on the computer's monotonic clock [s]."""

    t_s: float
    image: Picture


@dataclass(frozen=True)
class Dropped:
    """A picture that cannot be used, and why."""

    reason: str


class StreamReceiver(Protocol):
    """The receiving end of a stream; after it was made only one thread uses it."""

    @property
    def description(self) -> str:
        """Its name in messages."""

    def receive(self) -> Received | Dropped:
        """Wait for the next picture, at most about `STREAM_TIMEOUT_S`. Raises `CameraError` when none can follow."""

    def close(self) -> None:
        """Close the stream."""


class StreamSource:
    """Pictures of a stream.

    Parameters
    ----------
    receiver : StreamReceiver
        The open stream; only the thread uses and closes it.
    clock : Clock
        Rig time.
    bound_s : float
        How far the time of a picture may be from its exposure [s].
    timeout_s : float
        The longest wait for a picture [s].
    monotonic_s : callable
        The computer's monotonic time [s].
    """

    def __init__(
        self,
        receiver: StreamReceiver,
        clock: Clock,
        *,
        bound_s: float,
        timeout_s: float = STREAM_TIMEOUT_S,
        monotonic_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self.description = receiver.description
        self.exposures = 0
        self.overtaken = 0
        self._receiver = receiver
        self._clock = clock
        self._bound_s = bound_s
        self._timeout_s = timeout_s
        self._monotonic_s = monotonic_s
        self._queue: deque[Received] = deque()
        self._size: Mapping[str, int] = {}
        self._dropped = Dropped("")
        self._failure: CameraError | None = None
        self._changed = Condition()
        self._is_over = False
        self._thread = Thread(target=self._receive, name="labrig stream", daemon=True)
        self._thread.start()

    def wait_for_first(self) -> None:
        """Wait for the first picture.

        Raises
        ------
        CameraError
            When none arrives in time; the stream is closed then.
        """
        with self._changed:
            self._changed.wait_for(lambda: self._is_over or self._size, self._timeout_s)
            error = None if self._size else self._make_error()
        if error is not None:
            self.close()
            raise error

    def set(self, name: str, value: Setting) -> None:
        """Do nothing: a stream has no settings."""

    def get(self, name: str) -> Setting | None:
        """Return the width or height of the newest picture; None before the first."""
        return self._size.get(name)

    def read(self) -> Exposure:
        """Return a picture whose time is so long after this call that it was exposed after it.

        Raises
        ------
        CameraError
            When no picture arrives in time, or the stream has ended.
        """
        asked_s, asked_rig_s = self._monotonic_s(), self._clock.now_s()
        with self._changed:
            self._changed.wait_for(
                lambda: self._is_over or self._find_newest_since(asked_s) is not None, self._timeout_s
            )
            found = self._find_newest_since(asked_s)
        if found is None:
            raise self._make_error()
        age_s = self._monotonic_s() - found.t_s
        # Simulated time does not pass during the wait.
        return Exposure(found.image, max(self._clock.now_s() - age_s, asked_rig_s), self._bound_s)

    def _find_newest_since(self, asked_s: float) -> Received | None:
        return next((picture for picture in self._queue if picture.t_s >= asked_s + self._bound_s), None)

    def _make_error(self) -> CameraError:
        """Return why no picture can be returned."""
        failure = self._failure
        if failure is not None:
            return CameraError(f"{self.description}: {failure.message}, after {self.exposures}", failure.hint)
        how = f"gave no picture within {self._timeout_s:g} s"
        if self._dropped.reason:
            how = f"gave none that can be used within {self._timeout_s:g} s; the last one: {self._dropped.reason}"
        return CameraError(f"{self.description}: it {how}, after {self.exposures}", "check the sender")

    def _receive(self) -> None:
        """Keep the newest pictures until the stream ends or is closed; older ones are dropped and counted."""
        while not self._is_over:
            try:
                self._keep(self._receiver.receive())
            except CameraError as error:
                with self._changed:
                    self._failure, self._is_over = error, True
                    self._changed.notify_all()
        self._receiver.close()

    def _keep(self, picture: Received | Dropped) -> None:
        with self._changed:
            self.exposures += 1
            if isinstance(picture, Dropped):
                self._dropped = picture
                return
            self._dropped = Dropped("")
            self._size = {"width_px": picture.image.shape[1], "height_px": picture.image.shape[0]}
            self._queue.append(picture)
            if len(self._queue) > _QUEUED_PICTURES:
                self._queue.popleft()
                self.overtaken += 1
            self._changed.notify_all()

    def close(self) -> None:
        """End the thread; a read of the stream may delay that until its timeout."""
        with self._changed:
            self._is_over = True
        self._thread.join(self._timeout_s + 1.0)
