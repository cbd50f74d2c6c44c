"""Does what may block, such as reading a camera or forcing a file to disk, in a thread of its own.

The thread that supervises the axes waits for it and supervises meanwhile. It alone sends heartbeats: a camera that
hangs delays no beat, and a worker that goes on while the supervisor hangs sends none.
"""

import math
from collections.abc import Callable
from concurrent.futures import Future
from functools import partial
from queue import SimpleQueue
from threading import Thread
from typing import Any, TypeVar

from labrig.clock import Clock

_LOOK_S = 0.02
"""Longest time between two calls of `meanwhile` [s]."""

_T = TypeVar("_T")


class StillBusyError(Exception):
    """A call has not ended within its limit; it goes on, and later calls of its worker wait for it."""


class Worker:
    """Does one call after another, here in the thread that calls: nothing waits in simulated or recorded time."""

    def do(
        self,
        call: Callable[[], _T],
        meanwhile: Callable[[], None],  # noqa: ARG002 - nothing waits
        limit_s: float = math.inf,  # noqa: ARG002
    ) -> _T:
        """Do something, and call `meanwhile` some fifty times a second until it is done.

        Parameters
        ----------
        call : callable
            What may block.
        meanwhile : callable
            Supervises; its error ends the wait, and `call` goes on.
        limit_s : float
            Longest wait, in rig time [s].

        Raises
        ------
        StillBusyError
            After `limit_s`.
        Exception
            Those of `call` and `meanwhile`.
        """
        return call()

    def close(self, within_s: float = math.inf) -> None:
        """End once every call is done; wait at most `within_s` for it."""


SAME_THREAD = Worker()


def _wait_until_done(future: Future[Any], longest_s: float) -> bool:
    """Wait for a call, at most so long; tell whether it is done."""
    try:
        future.exception(longest_s)
    except TimeoutError:
        return False
    return True


class WorkerThread(Worker):
    """A worker with a thread, which begins with the first call. It does not keep a process alive that ends.

    Parameters
    ----------
    name : str
        Name of the thread.
    clock : Clock
        Rig time, for limits.
    wait : callable
        Waits for a call, at most so many seconds of rig time, and tells whether it is done.
    """

    def __init__(
        self, name: str, clock: Clock, wait: Callable[[Future[Any], float], bool] = _wait_until_done
    ) -> None:
        self._name = name
        self._clock = clock
        self._wait = wait
        self._tasks: SimpleQueue[Callable[[], None] | None] = SimpleQueue()
        self._thread: Thread | None = None

    def do(self, call: Callable[[], _T], meanwhile: Callable[[], None], limit_s: float = math.inf) -> _T:
        """Do something in the thread, as `Worker` says."""
        if self._thread is None:
            self._thread = Thread(target=self._serve, name=f"labrig {self._name}", daemon=True)
            self._thread.start()
        future, deadline_s = Future[_T](), self._clock.now_s() + limit_s
        self._tasks.put(partial(_run, call, future))
        while not self._wait(future, _LOOK_S):
            meanwhile()
            if self._clock.now_s() > deadline_s:
                raise StillBusyError(self._name)
        return future.result()

    def _serve(self) -> None:
        while (task := self._tasks.get()) is not None:
            task()

    def close(self, within_s: float = math.inf) -> None:
        """End the thread."""
        if self._thread is not None:
            self._tasks.put(None)
            self._thread.join(None if math.isinf(within_s) else within_s)


def _run(call: Callable[[], _T], future: Future[_T]) -> None:
    try:
        future.set_result(call())
    except BaseException as error:  # noqa: BLE001 - it is raised in the thread that waits
        future.set_exception(error)
