"""Do many independent tasks in other processes, on this computer or a cluster; what they came to stands in their order.

A worker that is lost costs the time of its tasks: they are done again. A task that fails, or that takes its worker down
with it, is a value among the others. Nothing here changes a result: neither the kind of pool, nor the number of
workers, nor the size of a batch.
"""

import math
import multiprocessing
import os
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures import CancelledError, Executor, Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cache
from itertools import islice
from traceback import extract_tb
from typing import Any, Generic, TypeVar

import cv2
from threadpoolctl import threadpool_limits

from labrig.analysis.installation import require_installation
from labrig.clock import Clock
from labrig.errors import BugError, LabrigError, MachineError
from labrig.posix import WORKER_START_METHOD, count_usable_cores, end_with_parent

DEFAULT_WORKERS = min(count_usable_cores(), 8)

BATCH_S = 0.1
"""The least time of a batch whose tasks are timed: scheduling one takes a scheduler about a millisecond."""

_LARGEST_BATCH = 1000
# Batches submitted for each worker while the first one is waited for: enough that no worker idles behind a task that
# takes four times as long as others, few enough that what waits takes no memory.
_BATCHES_AHEAD = 4
_MOST_LOSSES = 2
_THREAD_COUNTS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")

_Task = TypeVar("_Task")
_Result = TypeVar("_Result")


class Pool(ABC):
    """Workers that do batches of tasks, and are replaced when they are lost.

    Attributes
    ----------
    work : str
        What they do, in the past tense, for messages.
    """

    def __init__(self, work: str) -> None:
        self.work = work

    @property
    @abstractmethod
    def executor(self) -> Executor:
        """What batches are submitted to; another one after `renew`."""

    @property
    @abstractmethod
    def installation(self) -> str | None:
        """The digest that a worker must have of its own installation; None if it cannot have another."""

    @abstractmethod
    def count_workers(self) -> int:
        """Return how many batches are done at a time, at least 1."""

    @abstractmethod
    def is_loss(self, error: BaseException) -> bool:
        """Return whether a batch that ended so has lost its worker, and may be done again."""

    @abstractmethod
    def renew(self) -> None:
        """Replace what a lost worker broke. When this returns, the future of every batch that was lost is done."""

    @abstractmethod
    def require_usable(self, error: BaseException) -> None:
        """Raise the reason, a `MachineError`, if no further batch can be done after such an error."""


class _ProcessPool(Pool):
    """Forked processes of this computer.

    They start in milliseconds, share what is loaded, and end with their parent.
    """

    installation = None

    def __init__(self, workers: int, work: str) -> None:
        super().__init__(work)
        self._workers = workers
        self._executor = self._open()

    def _open(self) -> ProcessPoolExecutor:
        return ProcessPoolExecutor(
            self._workers, multiprocessing.get_context(WORKER_START_METHOD), end_with_parent
        )

    @property
    def executor(self) -> Executor:
        return self._executor

    def count_workers(self) -> int:
        return self._workers

    def is_loss(self, error: BaseException) -> bool:
        return isinstance(error, BrokenProcessPool)

    def renew(self) -> None:
        self.close()
        self._executor = self._open()

    def require_usable(self, error: BaseException) -> None:
        """Forked workers have the code of their parent: what one cannot do, the next one cannot either."""

    def close(self) -> None:
        self._executor.shutdown(cancel_futures=True)


@contextmanager
def open_process_pool(workers: int, work: str) -> Iterator[Pool]:
    """Give a pool of processes of this computer; batches that have not begun are dropped when the block ends.

    Parameters
    ----------
    workers : int
        Processes, at least 1.
    work : str
        What they do, in the past tense, for messages: "simulated insertions".
    """
    threads = cv2.getNumThreads()
    # OpenCV's threads do not survive a fork, and a worker would wait for them for ever, so they are ended first.
    cv2.setNumThreads(1)
    pool = _ProcessPool(workers, work)
    try:
        yield pool
    finally:
        pool.close()
        cv2.setNumThreads(threads)


def run_in_order(
    pool: Pool,
    call: Callable[[_Task], _Result],
    tasks: Iterable[_Task],
    *,
    clock: Clock | None = None,
) -> Generator[_Result | LabrigError, None, None]:
    """Yield what each task came to, in the order of the tasks.

    A bounded number of tasks is drawn ahead of the result that is waited for, so memory does not grow with them.

    Parameters
    ----------
    call : callable
        Does a task in a worker; it, the tasks and the results are pickled. The result may depend on the task alone.
    tasks : iterable
        Drawn as they are needed.
    clock : Clock or None
        Times the tasks in the workers, so that batches take `BATCH_S` or more; pickled. None: each task is a batch, for
        tasks that take that long by themselves.

    Yields
    ------
    result or LabrigError
        The error if `call` raised one; a `BugError` if it raised anything else, or came to what cannot be pickled; a
        `MachineError` if its worker was lost each time, usually because memory ran out.

    Raises
    ------
    MachineError
        When the pool can do no further task.
    """
    stream = _Stream(pool, call, iter(tasks), clock)
    try:
        while (batch := stream.take_next()) is not None:
            yield from stream.finish(batch)
    finally:
        stream.cancel()


@dataclass(frozen=True)
class _Answer(Generic[_Result]):
    """What the tasks of a batch came to, and how long they took [s]; None without a clock."""

    outcomes: list[_Result | LabrigError]
    took_s: float | None


@dataclass(eq=False)
class _Batch(Generic[_Task, _Result]):
    """Consecutive tasks, and how often their worker may have been lost by them."""

    tasks: Sequence[_Task]
    future: "Future[_Answer[_Result]]" = field(default_factory=Future)
    losses: int = 0


class _Stream(Generic[_Task, _Result]):
    """The batches that are submitted and not yet answered, in order."""

    def __init__(
        self, pool: Pool, call: Callable[[_Task], _Result], tasks: Iterator[_Task], clock: Clock | None
    ) -> None:
        self._pool = pool
        self._call = call
        self._tasks = tasks
        self._clock = clock
        self._size = _BatchSize()
        self._pending: deque[_Batch[_Task, _Result]] = deque()

    def take_next(self) -> _Batch[_Task, _Result] | None:
        """Submit as many batches as may wait, and return the first one; None if all tasks are done."""
        most = _BATCHES_AHEAD * self._pool.count_workers()
        while len(self._pending) < most:
            tasks = tuple(islice(self._tasks, self._size.tasks))
            if not tasks:
                break
            self._pending.append(_Batch(tasks, self._submit(tasks)))
        return self._pending.popleft() if self._pending else None

    def finish(self, batch: _Batch[_Task, _Result]) -> Sequence[_Result | LabrigError]:
        """Wait for a batch, and do it again if its worker is lost."""
        while (error := _wait(batch.future)) is not None:
            if self._pool.is_loss(error):
                self._recover(batch)
            else:
                self._require_usable(error)
                self._do_apart(batch)
        answer = batch.future.result()
        if answer.took_s is not None:
            self._size.learn(len(batch.tasks), answer.took_s)
        return answer.outcomes

    def cancel(self) -> None:
        """Drop the batches that have not begun."""
        for batch in self._pending:
            batch.future.cancel()

    def _submit(self, tasks: Sequence[_Task]) -> "Future[_Answer[_Result]]":
        try:
            return self._pool.executor.submit(
                _do_batch, self._call, tasks, self._clock, self._pool.installation
            )
        except Exception as error:  # noqa: BLE001 - told from a batch that fails later by nothing
            failed: Future[_Answer[_Result]] = Future()
            failed.set_exception(error)
            return failed

    def _recover(self, batch: _Batch[_Task, _Result]) -> None:
        """Do lost batches again: together at first, and apart those whose workers were lost twice.

        A process pool loses every batch with a worker. Those that were being done are among the first ones, as many as
        there are workers.
        """
        self._pool.renew()
        lost = [each for each in (batch, *self._pending) if self._is_lost(each)]
        suspects = lost[: self._pool.count_workers()]
        for suspect in suspects:
            suspect.losses += 1
            if suspect.losses >= _MOST_LOSSES:
                self._do_apart(suspect)
        for waiting in lost:
            if waiting.losses < _MOST_LOSSES:
                waiting.future = self._submit(waiting.tasks)

    def _is_lost(self, batch: _Batch[_Task, _Result]) -> bool:
        error = _wait(batch.future) if batch.future.done() else None
        return error is not None and self._pool.is_loss(error)

    def _require_usable(self, error: BaseException) -> None:
        """Raise the reason if no further task can be done; errors of tasks never come here."""
        if isinstance(error, MachineError):
            raise error
        self._pool.require_usable(error)

    def _do_apart(self, batch: _Batch[_Task, _Result]) -> None:
        """Do a batch while no other is submitted, and answer it in any case."""
        batch.future = Future()
        batch.future.set_result(_Answer(self._find_outcomes(batch.tasks), None))

    def _find_outcomes(self, tasks: Sequence[_Task]) -> list[_Result | LabrigError]:
        """Do tasks at once, else in halves, down to the one that cannot be done."""
        for _ in range(1 if len(tasks) > 1 else _MOST_LOSSES):
            future = self._submit(tasks)
            error = _wait(future)
            if error is None:
                return future.result().outcomes
            if self._pool.is_loss(error):
                self._pool.renew()
            else:
                self._require_usable(error)
        if len(tasks) > 1:
            half = len(tasks) // 2
            return self._find_outcomes(tasks[:half]) + self._find_outcomes(tasks[half:])
        return [self._describe_failure(error)]

    def _describe_failure(self, error: BaseException | None) -> LabrigError:
        if error is not None and self._pool.is_loss(error):
            return MachineError(
                f"a process that {self._pool.work} died {_MOST_LOSSES} times in the same task",
                "free some memory, or use fewer processes, and try again",
            )
        return BugError(f"labrig itself failed: {type(error).__name__}: {error}", "please report it")


class _BatchSize:
    """The tasks of the next batch, from what the batches before took; 1 until something is known."""

    def __init__(self) -> None:
        self.tasks = 1
        self._cost_s: float | None = None

    def learn(self, tasks: int, took_s: float) -> None:
        """Take the time of a batch into account."""
        cost_s = max(took_s, 0.0) / tasks
        self._cost_s = cost_s if self._cost_s is None else 0.5 * (self._cost_s + cost_s)
        wanted = math.ceil(BATCH_S / self._cost_s) if self._cost_s > 0.0 else _LARGEST_BATCH
        # A first task that ends early says little of the others: batches at most double.
        self.tasks = max(1, min(wanted, 2 * self.tasks, _LARGEST_BATCH))


def _wait(future: "Future[Any]") -> BaseException | None:
    """Wait for a future and return its error, None without one; also that it was cancelled by somebody else."""
    try:
        return future.exception()
    except CancelledError as error:
        return error


def _do_batch(
    call: Callable[[_Task], _Result], tasks: Sequence[_Task], clock: Clock | None, installation: str | None
) -> _Answer[_Result]:
    """Do a batch in a worker.

    Raises
    ------
    MachineError
        When the worker's installation is not that of the command.
    """
    if installation is not None:
        require_installation(installation)
    _use_single_threads()
    before_s = 0.0 if clock is None else clock.now_s()
    outcomes = [_do_task(call, task) for task in tasks]
    return _Answer(outcomes, None if clock is None else clock.now_s() - before_s)


def _do_task(call: Callable[[_Task], _Result], task: _Task) -> _Result | LabrigError:
    try:
        return call(task)
    except LabrigError as error:
        return error
    except (Exception, SystemExit) as error:  # noqa: BLE001 - a bug in a task ends that task alone
        place = extract_tb(error.__traceback__)[-1]
        return BugError(
            f"labrig itself failed: {type(error).__name__}: {error} ({place.filename}, line {place.lineno})",
            "please report it",
        )


@cache
def _use_single_threads() -> None:
    """Compute with a thread for the rest of this worker: the sums of two threads are rounded otherwise than of one.

    The variables are for libraries that are loaded later.
    """
    os.environ.update(dict.fromkeys(_THREAD_COUNTS, "1"))
    threadpool_limits(1)
    cv2.setNumThreads(1)
