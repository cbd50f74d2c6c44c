"""Takes pictures of a camera and scores each, while landmarks are searched in one of them beside that."""

from collections import deque
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from typing import Any

from labrig.cli.signals import SignalNote
from labrig.clock import Clock
from labrig.devices.camera import Camera
from labrig.devices.clocks import SystemClock
from labrig.devices.worker import WorkerThread
from labrig.report.picture_page import PicturePage, ShownPicture
from labrig.vision.drawing import Landmark
from labrig.vision.picture import Picture
from labrig.vision.picture_quality import judge_quality, measure_flicker, measure_quality

_REMEMBERED = 64
_PERIOD_S = 0.1
"""Shortest time between two pictures that a person watches: nobody sees more, and a simulated camera has no rate."""


@dataclass
class CameraWatch:
    """Takes pictures and scores them, until as many are taken as are wanted or a signal has come.

    Attributes
    ----------
    camera : Camera
    shown : ShownPicture
        Heading and camera of every picture that is shown.
    wanted : int or None
        How many pictures; None: until a signal comes.
    interrupted : SignalNote
    page : PicturePage or None
        Shows every picture, with its scores and the landmarks of one shortly before.
    clock : Clock
        Paces pictures that a person watches.
    taken : list
        The scores of every picture, ready for JSON, if a number is wanted.
    last : ShownPicture or None
        The newest.
    landmarks : tuple of Landmark
        Those of the last picture that was searched; empty before.
    """

    camera: Camera
    shown: ShownPicture
    wanted: int | None
    interrupted: SignalNote
    page: PicturePage | None
    clock: Clock = field(default_factory=SystemClock)
    taken: list[dict[str, Any]] = field(default_factory=list)
    last: ShownPicture | None = None
    landmarks: tuple[Landmark, ...] = ()
    _times_s: deque[float] = field(default_factory=lambda: deque(maxlen=_REMEMBERED))
    _means: deque[float] = field(default_factory=lambda: deque(maxlen=_REMEMBERED))
    _shown_s: float = 0.0

    @property
    def has_ended(self) -> bool:
        """Whether no more pictures are taken."""
        enough = self.wanted is not None and self.last is not None and self.last.number >= self.wanted
        return enough or self.interrupted() is not None

    def step(self) -> None:
        """Take a picture and show it, unless all is over."""
        if self.has_ended:
            return
        if self.wanted is None:
            self.clock.sleep(max(0.0, self._shown_s + _PERIOD_S - self.clock.now_s()))
            self._shown_s = self.clock.now_s()
        frame = self.camera.capture()
        quality = measure_quality(frame.image)
        self._times_s.append(frame.t_s)
        self._means.append(quality.mean_grey)
        scores = judge_quality(quality, measure_flicker(self._times_s, self._means))
        self.last = replace(
            self.shown,
            number=frame.sequence + 1,
            image=frame.image,
            scores=scores,
            landmarks=self.landmarks,
        )
        if self.wanted is not None:
            self.taken.append({"picture": self.last.number, "scores": [asdict(score) for score in scores]})
        if self.page is not None:
            self.page.show(self.last)

    def search(self, find: Callable[[Picture], tuple[Landmark, ...]]) -> None:
        """Search one picture after another for landmarks, and take and show pictures meanwhile, to the end."""
        worker = WorkerThread("landmarks", self.clock)
        try:
            self.step()
            while not self.has_ended and self.last is not None:
                self.landmarks = worker.do(partial(find, self.last.image), self._step_until_stopped)
        except _StoppedError:
            return
        finally:
            # To the end of the search, a second or two: a thread that is inside OpenCV when Python ends aborts it.
            worker.close()

    def _step_until_stopped(self) -> None:
        self.step()
        if self.interrupted() is not None:
            raise _StoppedError


class _StoppedError(Exception):
    """A signal has come while landmarks were searched."""
