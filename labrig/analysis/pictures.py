"""Measuring many pictures, in worker processes, in an order that does not depend on them."""

import ctypes
import multiprocessing
import os
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import cv2

from labrig.errors import MachineError, PictureError, RecordError
from labrig.record import read_recorded_picture
from labrig.vision import (
    CurvatureMeasurement,
    CurvatureSettings,
    PlaneMap,
    measure_curvature,
)

Progress = Callable[[int, int], None]
DEFAULT_WORKERS = min(os.cpu_count() or 1, 8)
# Enough to keep a worker busy between two messages, few enough for a steady progress bar.
_PICTURES_A_MESSAGE = 4
# linux/prctl.h
_PR_SET_PDEATHSIG = 1


@dataclass(frozen=True)
class PictureFile:
    """A picture of the record: its file, and the SHA-256 that was noted when it was taken."""

    path: Path
    sha256: str


@dataclass(frozen=True)
class Unreadable:
    """A picture of which nothing can be said, and why.

    `damaged` says that it is missing, or is not the one that was recorded.
    """

    reason: str
    damaged: bool = False


Measured = CurvatureMeasurement | Unreadable


def measure_pictures(
    files: Sequence[PictureFile],
    plane: PlaneMap,
    settings: CurvatureSettings,
    workers: int = DEFAULT_WORKERS,
    progress: Progress | None = None,
) -> list[Measured]:
    """Measure every picture, in the order given, whatever the number of workers.

    A picture that cannot be read, or is not the one that was recorded, gives an `Unreadable` in its place.

    Parameters
    ----------
    progress : callable or None
        Called with how many are done and how many there are, after each picture.

    Raises
    ------
    MachineError
        When a worker process dies; the usual cause is that memory ran out.
    """
    results: list[Measured] = []
    with _mapping(min(workers, len(files))) as map_in_order:
        for result in map_in_order(partial(_measure, plane, settings), files):
            results.append(result)
            if progress is not None:
                progress(len(results), len(files))
    return results


MapInOrder = Callable[[Callable[[PictureFile], Measured], Sequence[PictureFile]], Iterator[Measured]]


@contextmanager
def _mapping(workers: int) -> Iterator[MapInOrder]:
    """Give a `map`: of this process for one worker, else of a pool of them."""
    if workers <= 1:
        yield map
        return
    threads = cv2.getNumThreads()
    # Workers are forked: they start in milliseconds and share what is loaded. OpenCV's threads do not
    # survive a fork, and a worker that waited for them would wait for ever; they are ended first.
    cv2.setNumThreads(1)
    pool = ProcessPoolExecutor(workers, multiprocessing.get_context("fork"), _depend_on_the_parent)
    try:
        yield partial(pool.map, chunksize=_PICTURES_A_MESSAGE)
    except BrokenProcessPool as error:
        raise MachineError(
            "a process that measured pictures died", "free some memory and analyse the run again"
        ) from error
    finally:
        pool.shutdown(cancel_futures=True)
        cv2.setNumThreads(threads)


def _depend_on_the_parent() -> None:
    # Ctrl+C reaches every process of the terminal, and the parent ends its workers. A signal sent to one
    # worker ends it.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    signal.signal(signal.SIGHUP, signal.SIG_DFL)
    # A parent that is killed ends nobody; its workers would wait for pictures for ever.
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)


def _measure(plane: PlaneMap, settings: CurvatureSettings, file: PictureFile) -> Measured:
    try:
        return measure_curvature(read_recorded_picture(file.path, file.sha256), plane, settings)
    except (PictureError, RecordError) as error:
        # Where the run lies on this computer is no part of a result.
        reason = error.message.replace(str(file.path), file.path.name)
        return Unreadable(reason, damaged=isinstance(error, RecordError))
