"""Worker processes that end with their parent."""

import multiprocessing
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager

import cv2

from labrig.errors import MachineError
from labrig.posix import WORKER_START_METHOD, count_usable_cores, end_with_parent

DEFAULT_WORKERS = min(count_usable_cores(), 8)


@contextmanager
def worker_processes(workers: int, task: str) -> Iterator[ProcessPoolExecutor]:
    """Give a pool of processes; calls that have not begun are dropped when the command is interrupted.

    Parameters
    ----------
    task : str
        What they do, in the past tense, for the message.

    Raises
    ------
    MachineError
        When one of them dies, usually because memory ran out.
    """
    threads = cv2.getNumThreads()
    # Workers are forked: they start in milliseconds and share what is loaded. OpenCV's threads do not survive a fork,
    # and a worker would wait for them for ever, so they are ended first.
    cv2.setNumThreads(1)
    pool = ProcessPoolExecutor(workers, multiprocessing.get_context(WORKER_START_METHOD), end_with_parent)
    try:
        yield pool
    except BrokenProcessPool as error:
        raise MachineError(f"a process that {task} died", "free some memory and try again") from error
    finally:
        pool.shutdown(cancel_futures=True)
        cv2.setNumThreads(threads)
