"""Forces a record to the disk by a thread of its own, so that a busy disk holds up neither axes nor camera.

A line that is durable must speak of a picture that is durable. So pictures are forced to disk first, while more are
taken; then, for the few milliseconds that it takes, no line is appended, and the last pictures and all lines follow.
"""

from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from threading import Lock
from typing import Protocol


class Syncable(Protocol):
    """What can be made durable while another thread writes more."""

    def sync(self) -> None:
        """Make what is written so far durable. Raises `OSError`."""
        ...


def sync_in_order(pictures: Syncable, lines: Sequence[Syncable], appending: Lock) -> None:
    """Make pictures and lines durable, no line before its picture.

    Parameters
    ----------
    pictures : Syncable
        A picture is written before its line.
    lines : sequence of Syncable
    appending : Lock
        Held by whoever appends a line.

    Raises
    ------
    OSError
        Where the disk refuses; what was not made durable is tried again by the next call.
    """
    pictures.sync()
    with appending:
        for one in (pictures, *lines):
            one.sync()


class Rounds:
    """Runs one round at a time in a thread of its own.

    A round that is due while another is under way is left out: the next one does its work too. Only when the
    `most_behind`-th is due does the caller wait. What a round raises is raised by the next call.
    """

    def __init__(self, most_behind: int) -> None:
        self._thread = ThreadPoolExecutor(max_workers=1, thread_name_prefix="fsync")
        self._most_behind = most_behind
        self._under_way: Future[None] | None = None
        self._behind = 0

    def begin(self, round_: Callable[[], None]) -> None:
        """Begin a round, if none is under way. Raises what the round before raised."""
        self._behind += 1
        if self._under_way is not None and not self._under_way.done() and self._behind < self._most_behind:
            return
        self.finish()
        self._under_way = self._thread.submit(round_)

    def finish(self) -> None:
        """Wait for the round that is under way. Raises what it raised."""
        under_way, self._under_way, self._behind = self._under_way, None, 0
        if under_way is not None:
            under_way.result()

    def close(self) -> None:
        """Let the thread go, once its round is through."""
        self._thread.shutdown()
