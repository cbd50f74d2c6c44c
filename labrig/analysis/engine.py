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
from concurrent.futures import CancelledError, Executor, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache, partial
from itertools import islice
from traceback import format_exc
from typing import Any, Generic, TypeVar

import cv2
from threadpoolctl import threadpool_limits

from labrig.analysis.installation import require_installation
from labrig.clock import Clock
from labrig.errors import BugError, LabrigError, MachineError, WorkersError
from labrig.posix import WORKER_START_METHOD, count_usable_cores, end_with_parent, hold_signals

DEFAULT_WORKERS = min(count_usable_cores(), 8)

BATCH_S = 0.1
"""The least time of a batch whose tasks are timed."""

BATCH_S_A_WORKER = 0.005
"""A scheduler takes one to three milliseconds for a batch, so batches are longer the more workers it has to feed."""

_LARGEST_BATCH = 1000
# Batches submitted for each worker while the first one is waited for: no worker idles behind a long task, or while the
# results are written, and what waits takes little memory.
_BATCHES_AHEAD = 16
_MOST_DEATHS = 2
_MEMORY_HINT = "free some memory, or use fewer processes, and try again"
_THREAD_COUNTS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")

_Task = TypeVar("_Task")
_Result = TypeVar("_Result")


class Pool(ABC):
    """Workers that do batches of tasks, and are replaced when they are lost.

    Attributes
    ----------
    work : str
        What they do, in the past tense, for messages.
    patience_s : float or None
        How long a batch is waited for before `renew` [s]; None where batches of lost workers come back by themselves.
    unlike : tuple of str
        A sentence for each worker whose kernels are not those of this process, so that it rounds otherwise.
    """

    patience_s: float | None = None
    unlike: tuple[str, ...] = ()

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
    def count_deaths(self, error: BaseException) -> int | None:
        """Return how many workers may have died of a batch that ended so; None if it was not lost with a worker."""

    @abstractmethod
    def renew(self) -> None:
        """Replace what a lost worker broke; afterwards the future of every batch that was lost is done.

        Raises
        ------
        WorkersError
            When no worker can be had.
        """

    @abstractmethod
    def require_usable(self, error: BaseException) -> None:
        """Raise the reason, a `WorkersError`, if no further batch can be done after such an error."""


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

    def count_deaths(self, error: BaseException) -> int | None:
        return 1 if isinstance(error, BrokenProcessPool) else None

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


@dataclass(frozen=True)
class Answer(Generic[_Result]):
    """What the tasks of a batch came to, and how long they took [s]; None if nobody measured."""

    outcomes: list[_Result | LabrigError]
    took_s: float | None


@dataclass(eq=False)
class Batch(Generic[_Result]):
    """Tasks that are done one after the other in one worker; only `WorkQueue` makes and reads it."""

    call: Callable[[Any], _Result]
    tasks: Sequence[Any]
    clock: Clock | None
    future: "Future[Answer[_Result]]"
    deaths: int = 0
    """How many workers may have died of it."""


class WorkQueue:
    """Batches that a pool does, and does again when a worker is lost.

    Parameters
    ----------
    pool : Pool
        Used by nobody else meanwhile.
    """

    def __init__(self, pool: Pool) -> None:
        self._pool = pool
        self._pending: dict[Batch[Any], None] = {}

    def submit(
        self, call: Callable[[_Task], _Result], tasks: Sequence[_Task], clock: Clock | None = None
    ) -> Batch[_Result]:
        """Submit tasks as a batch; with a clock its answer says how long they took."""
        batch = Batch(call, tasks, clock, self._send(call, tasks, clock))
        self._pending[batch] = None
        return batch

    def wait(self, batch: Batch[_Result]) -> Answer[_Result]:
        """Wait for a batch, and return what its tasks came to.

        Raises
        ------
        WorkersError
            When the pool can do no further task.
        """
        while (error := self._wait_for_error(batch.future)) is not None:
            if self._pool.count_deaths(error) is not None:
                self._recover()
            else:
                self._require_usable(error)
                self._do_apart(batch)
        del self._pending[batch]
        return batch.future.result()

    def begin(self, call: Callable[[], _Result]) -> Callable[[], _Result]:
        """Submit a call; return a function that waits for its result, or raises the `LabrigError` that it came to."""
        batch = self.submit(_call_without_task, [call])

        def wait_for_result() -> _Result:
            (outcome,) = self.wait(batch).outcomes
            if isinstance(outcome, LabrigError):
                raise outcome
            return outcome

        return wait_for_result

    def map(self, call: Callable[[_Task], _Result], tasks: Iterable[_Task]) -> Iterator[_Result]:
        """Do all tasks, as `Executor.map` does; the first one that fails raises its `LabrigError`."""
        waits = [self.begin(partial(call, task)) for task in tasks]
        return (wait() for wait in waits)

    def drop(self) -> None:
        """Drop the batches that have not begun."""
        for batch in self._pending:
            batch.future.cancel()
        self._pending.clear()

    def _wait_for_error(self, future: "Future[Any]") -> BaseException | None:
        """Wait for a future and return its error, None without one; also that it was cancelled by somebody else.

        Raises
        ------
        WorkersError
            When no worker is left to do it.
        """
        while not wait([future], self._pool.patience_s).done:
            self._pool.renew()
        return _find_error(future)

    def _send(
        self, call: Callable[[_Task], _Result], tasks: Sequence[_Task], clock: Clock | None
    ) -> "Future[Answer[_Result]]":
        future: Future[Answer[_Result]] = Future()
        try:
            with hold_signals():  # it may fork
                future = self._pool.executor.submit(_do_batch, call, tasks, clock, self._pool.installation)
        except Exception as error:  # noqa: BLE001 - as if it came a moment later, whatever the executor
            future.set_exception(error)
        return future

    def _recover(self) -> None:
        """Do lost batches again: together at first, and apart those of which workers may have died twice.

        A process pool loses every batch with a worker. Those that were being done are among the first ones, as many as
        there are workers.
        """
        self._pool.renew()
        lost = {batch: deaths for batch in self._pending if (deaths := self._count_deaths(batch)) is not None}
        for suspect in list(lost)[: self._pool.count_workers()]:
            suspect.deaths += lost[suspect]
            if suspect.deaths >= _MOST_DEATHS:
                self._do_apart(suspect)
                del lost[suspect]
        for batch in lost:
            batch.future = self._send(batch.call, batch.tasks, batch.clock)

    def _count_deaths(self, batch: Batch[Any]) -> int | None:
        """Return how many workers may have died of a batch that was lost; None if it was not lost, or is not done."""
        error = _find_error(batch.future) if batch.future.done() else None
        return None if error is None else self._pool.count_deaths(error)

    def _require_usable(self, error: BaseException) -> None:
        """Raise the reason if no further task can be done; errors of tasks never come here."""
        if isinstance(error, WorkersError):
            raise error
        self._pool.require_usable(error)

    def _do_apart(self, batch: Batch[_Result]) -> None:
        """Do a batch when nothing else is being done, so that no other can be blamed, and answer it in any case."""
        for other in self._pending:
            if other is not batch:
                self._wait_for_error(other.future)
        self._pool.renew()
        outcomes = self._find_outcomes(batch.call, batch.tasks)
        batch.future = Future()
        batch.future.set_result(Answer(outcomes, None))

    def _find_outcomes(
        self, call: Callable[[_Task], _Result], tasks: Sequence[_Task]
    ) -> list[_Result | LabrigError]:
        """Do tasks at once, else in halves, down to the one that cannot be done."""
        deaths = 0
        while True:
            future = self._send(call, tasks, None)
            error = self._wait_for_error(future)
            if error is None:
                return future.result().outcomes
            died = self._pool.count_deaths(error)
            if died is None:
                self._require_usable(error)
            else:
                self._pool.renew()
                deaths += died
            if len(tasks) > 1:
                half = len(tasks) // 2
                return self._find_outcomes(call, tasks[:half]) + self._find_outcomes(call, tasks[half:])
            if died is None:
                bug = f"labrig itself failed: {type(error).__name__}: {error}"
                return [BugError(bug, "please report it")]
            if deaths >= _MOST_DEATHS:
                died_of_it = (
                    f"a process that {self._pool.work} died of its task, {_MOST_DEATHS} times or more"
                )
                return [MachineError(died_of_it, _MEMORY_HINT)]


def run_in_order(
    pool: Pool,
    call: Callable[[_Task], _Result],
    tasks: Iterable[_Task],
    *,
    clock: Clock | None = None,
) -> Generator[_Result | LabrigError, None, None]:
    """Yield what each task came to, in the order of the tasks.

    A bounded number of tasks is drawn ahead of the result that is waited for, so memory does not grow with them. When
    the generator is closed, what has not begun is dropped.

    Parameters
    ----------
    call : callable
        Does a task in a worker; it, the tasks and the results are pickled. The result may depend on the task alone. A
        `WorkersError` that it raises ends everything.
    tasks : iterable
        Drawn as they are needed.
    clock : Clock or None
        Times the tasks in the workers, so that batches take `BATCH_S` or more; pickled. None: each task is a batch, for
        tasks that take that long by themselves.

    Yields
    ------
    result or LabrigError
        The error if `call` raised one; a `BugError`, with the traceback as its note, if it raised anything else, or
        came to what cannot be pickled; a `MachineError` if its worker was lost each time, usually because memory ran
        out.

    Raises
    ------
    WorkersError
        When the pool can do no further task.
    """
    queue = WorkQueue(pool)
    size = _BatchSize()
    ahead: deque[Batch[_Result]] = deque()
    left = iter(tasks)
    try:
        while True:
            while len(ahead) < _BATCHES_AHEAD * pool.count_workers():
                some = tuple(islice(left, size.tasks))
                if not some:
                    break
                ahead.append(queue.submit(call, some, clock))
            if not ahead:
                return
            batch = ahead.popleft()
            answer = queue.wait(batch)
            size.learn(len(batch.tasks), answer.took_s, pool.count_workers())
            yield from answer.outcomes
    finally:
        queue.drop()


class _BatchSize:
    """The tasks of the next batch, from what the batches before took; 1 until something is known."""

    def __init__(self) -> None:
        self.tasks = 1
        self._cost_s: float | None = None

    def learn(self, tasks: int, took_s: float | None, workers: int) -> None:
        """Take the time of a batch into account, if it is known, for batches that go to so many workers."""
        if took_s is None:
            return
        cost_s = max(took_s, 0.0) / tasks
        self._cost_s = cost_s if self._cost_s is None else 0.5 * (self._cost_s + cost_s)
        batch_s = max(BATCH_S, BATCH_S_A_WORKER * workers)
        wanted = math.ceil(batch_s / self._cost_s) if self._cost_s > 0.0 else _LARGEST_BATCH
        # A first task that ends early says little of the others: batches at most double.
        self.tasks = max(1, min(wanted, 2 * self.tasks, _LARGEST_BATCH))


def _find_error(future: "Future[Any]") -> BaseException | None:
    """Return the error of a future that is done, None without one; also that it was cancelled by somebody else."""
    try:
        return future.exception()
    except CancelledError as error:
        return error


def _do_batch(
    call: Callable[[_Task], _Result], tasks: Sequence[_Task], clock: Clock | None, installation: str | None
) -> Answer[_Result]:
    """Do a batch in a worker.

    Raises
    ------
    WorkersError
        When the worker's installation is not that of the command, or it cannot do these tasks.
    """
    if installation is not None:
        require_installation(installation)
    _use_single_threads()
    before_s = 0.0 if clock is None else clock.now_s()
    outcomes = [_do_task(call, task) for task in tasks]
    return Answer(outcomes, None if clock is None else clock.now_s() - before_s)


def _do_task(call: Callable[[_Task], _Result], task: _Task) -> _Result | LabrigError:
    try:
        return call(task)
    except WorkersError:
        raise
    except LabrigError as error:
        return error
    except MemoryError:
        return MachineError("a worker has too little memory for its task", _MEMORY_HINT)
    except (Exception, SystemExit) as error:  # noqa: BLE001 - a bug in a task ends that task alone
        bug = BugError(f"labrig itself failed: {type(error).__name__}: {error}", "please report it")
        bug.add_note(format_exc())
        return bug


def _call_without_task(call: Callable[[], _Result]) -> _Result:
    return call()


@cache
def _use_single_threads() -> None:
    """Compute with a thread for the rest of this worker: the sums of two threads are rounded otherwise than of one.

    The variables are for libraries that are loaded later.
    """
    os.environ.update(dict.fromkeys(_THREAD_COUNTS, "1"))
    threadpool_limits(1)
    cv2.setNumThreads(1)
