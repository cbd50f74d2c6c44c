"""Worker processes that end with their parent."""

import ctypes
import multiprocessing
import os
import signal
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager

import cv2

from labrig.errors import MachineError

DEFAULT_WORKERS = min(os.cpu_count() or 1, 8)
# linux/prctl.h
_PR_SET_PDEATHSIG = 1


@contextmanager
def worker_processes(workers: int, task: str) -> Iterator[ProcessPoolExecutor]:
    """Give a pool of processes; what has not begun is dropped when the command is interrupted.

    Parameters
    ----------
    task : str
        What they do, in the past tense, for the message.

    Raises
    ------
    MachineError
        When one of them dies; the usual cause is that memory ran out.
    """
    threads = cv2.getNumThreads()
    # Workers are forked: they start in milliseconds and share what is loaded. OpenCV's threads do not
    # survive a fork, and a worker that waited for them would wait for ever; they are ended first.
    cv2.setNumThreads(1)
    pool = ProcessPoolExecutor(workers, multiprocessing.get_context("fork"), _depend_on_the_parent)
    try:
        yield pool
    except BrokenProcessPool as error:
        raise MachineError(f"a process that {task} died", "free some memory and try again") from error
    finally:
        pool.shutdown(cancel_futures=True)
        cv2.setNumThreads(threads)


def _depend_on_the_parent() -> None:
    # Ctrl+C reaches every process of the terminal, and the parent ends its workers. A signal sent to one
    # worker ends it.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    signal.signal(signal.SIGHUP, signal.SIG_DFL)
    # A parent that is killed ends nobody; its workers would wait for work for ever.
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
