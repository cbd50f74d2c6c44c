"""Measuring many pictures, in worker processes, in an order that does not depend on them."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from labrig.analysis.workers import DEFAULT_WORKERS, worker_processes
from labrig.errors import PictureError, RecordError
from labrig.record import RecordedPicture
from labrig.vision import (
    CurvatureMeasurement,
    CurvatureSettings,
    Mask,
    PlaneMap,
    measure_curvature,
)

Progress = Callable[[int, int], None]
# Enough to keep a worker busy between two messages, few enough for a steady progress bar.
_PICTURES_A_MESSAGE = 4


@dataclass(frozen=True)
class Unreadable:
    """A picture of which nothing can be said, and why.

    `damaged` says that it is missing, or is not the one that was recorded.
    """

    reason: str
    damaged: bool = False


Measured = CurvatureMeasurement | Unreadable


def measure_pictures(
    pictures: Sequence[RecordedPicture],
    plane: PlaneMap,
    settings: CurvatureSettings,
    workers: int = DEFAULT_WORKERS,
    progress: Progress | None = None,
    *,
    mask: Mask | None = None,
) -> list[Measured]:
    """Measure every picture, in the order given, whatever the number of workers.

    A picture that cannot be read, or is not the one that was recorded, gives an `Unreadable` in its place.

    Parameters
    ----------
    progress : callable or None
        Called with how many are done and how many there are, after each picture.
    mask : Mask or None
        Pixels that are not the needle.

    Raises
    ------
    MachineError
        When a worker process dies; the usual cause is that memory ran out.
    """
    results: list[Measured] = []
    with _mapping(min(workers, len(pictures))) as map_in_order:
        for result in map_in_order(partial(_measure, plane, settings, mask), pictures):
            results.append(result)
            if progress is not None:
                progress(len(results), len(pictures))
    return results


MapInOrder = Callable[[Callable[[RecordedPicture], Measured], Sequence[RecordedPicture]], Iterator[Measured]]


@contextmanager
def _mapping(workers: int) -> Iterator[MapInOrder]:
    """Give a `map`: of this process for one worker, else of a pool of them."""
    if workers <= 1:
        yield map
        return
    with worker_processes(workers, "measured pictures") as pool:
        yield partial(pool.map, chunksize=_PICTURES_A_MESSAGE)


def _measure(
    plane: PlaneMap, settings: CurvatureSettings, mask: Mask | None, picture: RecordedPicture
) -> Measured:
    try:
        image = picture.read()
        masked = None if mask is None else mask.masked(Path(picture.file).name, image)
        return measure_curvature(image, plane, settings, masked=masked)
    except (PictureError, RecordError) as error:
        # Where the run lies on this computer is no part of a result.
        reason = error.message.replace(str(picture.run / picture.file), Path(picture.file).name)
        return Unreadable(reason, damaged=isinstance(error, RecordError))
