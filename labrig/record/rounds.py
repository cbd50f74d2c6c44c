"""Do the work of a disk in a thread of its own, so that a busy disk holds up neither axes nor camera."""

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor


class Rounds:
    """Runs one round at a time in a thread of its own.

    A round that is due while another is running is skipped; the next one does its work too. Only when `most_behind`
    rounds are due does the caller wait. An error in a round is raised by the next call.
    """

    def __init__(self, most_behind: int) -> None:
        self._thread = ThreadPoolExecutor(max_workers=1, thread_name_prefix="fsync")
        self._most_behind = most_behind
        self._running: Future[None] | None = None
        self._behind = 0

    def begin(self, round_: Callable[[], None]) -> None:
        """Begin a round unless one is running. Raises the error of the previous round."""
        self._behind += 1
        if self._running is not None and not self._running.done() and self._behind < self._most_behind:
            return
        self.finish()
        self._running = self._thread.submit(round_)

    def finish(self) -> None:
        """Wait for the running round. Raises its error."""
        running, self._running, self._behind = self._running, None, 0
        if running is not None:
            running.result()

    def close(self) -> None:
        """End the thread after its round."""
        self._thread.shutdown()
