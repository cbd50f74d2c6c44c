"""Do many independent tasks in other processes, on this computer or a cluster; what they came to stands in their order.

A worker that is lost costs the time of its tasks: they are done again. A task that fails, or that takes its worker down
with it, is a value among the others. Nothing here changes a result: neither the kind of pool, nor the number of
workers.
"""

import multiprocessing
import os
import platform
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping
from concurrent.futures import CancelledError, Executor, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing, contextmanager
from dataclasses import dataclass
from functools import cache
from importlib import metadata
from itertools import islice
from traceback import format_exc
from typing import Any, Generic, TypeVar

import cv2
import scipy.linalg  # noqa: F401 - what computes is loaded, so that its kernels can be described
from threadpoolctl import threadpool_limits

from labrig import __version__
from labrig.errors import BugError, LabrigError, MachineError, WorkersError
from labrig.posix import WORKER_START_METHOD, end_with_parent, hold_signals
from labrig.record.provenance import digest_sources

CORES = len(os.sched_getaffinity(0))
"""Those that this process may use: `taskset`, a container or a batch system may allow fewer than all."""
DEFAULT_WORKERS = min(CORES, 8)

# Tasks submitted for each worker while the first one is waited for: no worker idles behind a long task, or while the
# results are written, and what waits takes little memory.
_TASKS_AHEAD = 16
_MOST_DEATHS = 2
_MEMORY_HINT = "free some memory, or use fewer processes, and try again"
_INSTALL_HINT = "install the same labrig and the same packages wherever workers run, and start them anew"
_COMPUTING = ("numpy", "scipy", "opencv-python-headless", "filterpy", "shapely")

_Task = TypeVar("_Task")
_Result = TypeVar("_Result")


class Pool(ABC):
    """Workers that do tasks, and are replaced when they are lost.

    Attributes
    ----------
    work : str
        What they do, in the past tense, for messages.
    executor : Executor
        What tasks are submitted to; another one after `renew`.
    installation : Mapping or None
        What a worker must have installed; None if it cannot have another.
    patience_s : float or None
        How long a task is waited for before `renew` [s]; None where tasks of lost workers come back by themselves.
    """

    installation: Mapping[str, str] | None = None
    patience_s: float | None = None

    def __init__(self, work: str, executor: Executor) -> None:
        self.work = work
        self.executor = executor

    @abstractmethod
    def count_workers(self) -> int:
        """Return how many tasks are done at a time, at least 1."""

    @abstractmethod
    def count_deaths(self, error: BaseException) -> int | None:
        """Return how many workers may have died of a task that ended so; None if it was not lost with a worker."""

    @abstractmethod
    def renew(self) -> None:
        """Replace what a lost worker broke; afterwards the future of every task that was lost is done.

        Raises
        ------
        WorkersError
            When no worker can be had.
        """


class _ProcessPool(Pool):
    """Forked processes of this computer.

    They start in milliseconds, share what is loaded, and end with their parent.
    """

    def __init__(self, workers: int, work: str) -> None:
        self._workers = workers
        super().__init__(work, self._open())

    def _open(self) -> ProcessPoolExecutor:
        return ProcessPoolExecutor(
            self._workers, multiprocessing.get_context(WORKER_START_METHOD), end_with_parent
        )

    def count_workers(self) -> int:
        return self._workers

    def count_deaths(self, error: BaseException) -> int | None:
        return 1 if isinstance(error, BrokenProcessPool) else None

    def renew(self) -> None:
        self.close()
        self.executor = self._open()

    def close(self) -> None:
        self.executor.shutdown(cancel_futures=True)


@contextmanager
def open_process_pool(workers: int, work: str) -> Iterator[Pool]:
    """Give a pool of processes of this computer; tasks that have not begun are dropped when the block ends.

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


@dataclass(eq=False)
class _Job(Generic[_Task, _Result]):
    """A task, the future of what it comes to, and how many workers may have died of it."""

    task: _Task
    future: "Future[_Result | LabrigError]"
    deaths: int = 0


class _Queue(Generic[_Task, _Result]):
    """Tasks that a pool does, and does again when a worker is lost; what they came to is taken in their order."""

    def __init__(self, pool: Pool, call: Callable[[_Task], _Result]) -> None:
        self._pool = pool
        self._call = call
        self.jobs: deque[_Job[_Task, _Result]] = deque()

    def submit(self, task: _Task) -> None:
        self.jobs.append(_Job(task, self._send(task)))

    def take(self) -> _Result | LabrigError:
        """Return what the first task came to, once it has. Raises `WorkersError` when no further one can be done."""
        job = self.jobs[0]
        while (error := self._wait_for_error(job.future)) is not None:
            if self._pool.count_deaths(error) is not None:
                self._recover()
                continue
            if isinstance(error, WorkersError):
                raise error
            if isinstance(error, ImportError):
                raise WorkersError(f"a worker cannot import labrig: {error}", _INSTALL_HINT) from error
            self.jobs.popleft()
            return BugError(f"labrig itself failed: {type(error).__name__}: {error}", "please report it")
        return self.jobs.popleft().future.result()

    def drop(self) -> None:
        """Drop the tasks that have not begun."""
        for job in self.jobs:
            job.future.cancel()

    def _send(self, task: _Task) -> "Future[_Result | LabrigError]":
        future: Future[_Result | LabrigError] = Future()
        try:
            with hold_signals():  # it may fork
                future = self._pool.executor.submit(_do_task, self._call, task, self._pool.installation)
        except Exception as error:  # noqa: BLE001 - as if it came a moment later, whatever the executor
            future.set_exception(error)
        return future

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

    def _recover(self) -> None:
        """Do lost tasks again: together at first, and alone those of which workers may have died twice.

        A process pool loses every task with a worker. Those that were being done are among the first ones, as many as
        there are workers.
        """
        self._pool.renew()
        errors = {job: _find_error(job.future) for job in self.jobs if job.future.done()}
        deaths = {job: self._pool.count_deaths(error) for job, error in errors.items() if error is not None}
        lost = [job for job in deaths if deaths[job] is not None]
        for suspect in lost[: self._pool.count_workers()]:
            suspect.deaths += deaths[suspect] or 0
            if suspect.deaths >= _MOST_DEATHS:
                self._do_alone(suspect)
                lost.remove(suspect)
        for job in lost:
            job.future = self._send(job.task)

    def _do_alone(self, job: _Job[_Task, _Result]) -> None:
        """Do a task while nothing else is being done, so that no other can be blamed; give it up if workers die."""
        for other in self.jobs:
            if other is not job:
                self._wait_for_error(other.future)
        deaths = 0
        while deaths < _MOST_DEATHS:
            self._pool.renew()
            job.future = self._send(job.task)
            error = self._wait_for_error(job.future)
            died = None if error is None else self._pool.count_deaths(error)
            if died is None:
                return
            deaths += died
        told = f"a process that {self._pool.work} died of its task, {_MOST_DEATHS} times or more"
        job.future = Future()
        job.future.set_result(MachineError(told, _MEMORY_HINT))


def run_in_order(
    pool: Pool, call: Callable[[_Task], _Result], tasks: Iterable[_Task]
) -> Generator[_Result | LabrigError, None, None]:
    """Yield what each task came to, in the order of the tasks.

    A bounded number of tasks is drawn ahead of the result that is waited for, so memory does not grow with them. When
    the generator is closed, what has not begun is dropped.

    Parameters
    ----------
    pool : Pool
        Used by nobody else meanwhile.
    call : callable
        Does a task in a worker; it, the tasks and the results are pickled. The result may depend on the task alone. A
        `WorkersError` that it raises ends everything.
    tasks : iterable
        Drawn as they are needed.

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
    queue, left = _Queue(pool, call), iter(tasks)
    try:
        while True:
            for task in islice(left, max(0, _TASKS_AHEAD * pool.count_workers() - len(queue.jobs))):
                queue.submit(task)
            if not queue.jobs:
                return
            yield queue.take()
    finally:
        queue.drop()


def map_in_order(
    pool: Pool, call: Callable[[_Task], _Result], tasks: Iterable[_Task]
) -> Generator[_Result, None, None]:
    """Yield the result of each task in order, as `map` does; the first one that fails raises its `LabrigError`."""
    with closing(run_in_order(pool, call, tasks)) as outcomes:
        for outcome in outcomes:
            if isinstance(outcome, LabrigError):
                raise outcome
            yield outcome


def _find_error(future: "Future[Any]") -> BaseException | None:
    """Return the error of a future that is done, None without one; also that it was cancelled by somebody else."""
    try:
        return future.exception()
    except CancelledError as error:
        return error


def _do_task(
    call: Callable[[_Task], _Result], task: _Task, installation: Mapping[str, str] | None
) -> _Result | LabrigError:
    """Do a task in a worker.

    Raises
    ------
    WorkersError
        When the worker's installation is not that of the command, or it cannot do this task.
    """
    for name, expected in (installation or {}).items():
        if (found := describe_installation().get(name)) != expected:
            told = f"a worker on {platform.node()} has {name} {found}, this process has {expected}"
            raise WorkersError(told, _INSTALL_HINT)
    _use_single_threads()
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


@cache
def _use_single_threads() -> None:
    """Compute with a thread for the rest of this worker: the sums of two threads are rounded otherwise than of one."""
    threadpool_limits(1)
    cv2.setNumThreads(1)


@cache
def describe_installation() -> Mapping[str, str]:
    """Return what must be equal in two processes for their results to agree, by name.

    labrig's version and the SHA-256 of its code, Python's minor version, and the packages that compute.
    """
    return {
        "labrig": __version__,
        "source_sha256": digest_sources(),
        "python": ".".join(platform.python_version_tuple()[:2]),
        **{name: metadata.version(name) for name in _COMPUTING},
    }
