"""Measuring many pictures, in worker processes, in an order that does not depend on them."""

from collections.abc import Callable, Generator, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any, TypeAlias, TypeVar

from labrig.analysis.workers import worker_processes
from labrig.errors import PictureError, RecordError
from labrig.record.pictures import RecordedPicture
from labrig.vision.curvature import CurvatureMeasurement, CurvatureSettings, measure_curvature
from labrig.vision.mask import Mask
from labrig.vision.plane import PlaneMap

Progress = Callable[[int, int], None]
# Enough to keep a worker busy between two messages, few enough for a steady progress bar.
_PICTURES_A_MESSAGE = 4

_Result = TypeVar("_Result")


@dataclass(frozen=True)
class Unreadable:
    """A picture of which nothing can be said, and why.

    `damaged` says that it is missing, or is not the one that was recorded.
    """

    reason: str
    damaged: bool = False


Measured = CurvatureMeasurement | Unreadable


@dataclass(frozen=True)
class PictureWork:
    """What an analysis has to look at before it can go on.

    Attributes
    ----------
    pictures : tuple of RecordedPicture
        Those of the needle. One that cannot be read, or is not the one that was recorded, gives an `Unreadable`.
    plane, settings
        How they are measured.
    mask : Mask or None
        Pixels that are not the needle.
    others : tuple of callable
        What else takes long and can be done meanwhile; each is carried to another process and called there.
    """

    pictures: tuple[RecordedPicture, ...]
    plane: PlaneMap
    settings: CurvatureSettings
    mask: Mask | None = None
    others: tuple[Callable[[], Any], ...] = ()


@dataclass(frozen=True)
class Seen:
    """What came of a work: a measurement for each picture, and the answer of each of the others, in their order."""

    measured: tuple[Measured, ...]
    others: tuple[Any, ...]


Analysis: TypeAlias = Generator[PictureWork, Seen, _Result]
"""An analysis that asks for what it wants to look at, and goes on with what was seen."""

Part: TypeAlias = Callable[[], list[Any]]
"""A piece of a work: gives, or waits for, the answers to it."""


def concluded(
    analysis: Analysis[_Result], look: Callable[[PictureWork], Seen], answer: Seen | None = None
) -> _Result:
    """Return the result of an analysis; `look` sees what it asks for.

    Parameters
    ----------
    answer : Seen or None
        What came of the work that the analysis has asked for already; None for one that has not begun.
    """
    try:
        while True:
            answer = look(next(analysis) if answer is None else analysis.send(answer))
    except StopIteration as done:
        result: _Result = done.value
        return result


def look_at(work: PictureWork, workers: int, progress: Progress | None) -> Seen:
    """Measure every picture, in the order given, whatever the number of workers.

    Parameters
    ----------
    workers : int
        Processes; one is this process alone.
    progress : callable or None
        Called with how many pictures are done and how many there are.

    Raises
    ------
    MachineError
        When a worker process dies; the usual cause is that memory ran out.
    """
    workers = min(workers, len(work.pictures))
    if workers <= 1:
        return seen(work, _parts(work), progress)
    with worker_processes(workers, "measured pictures") as pool:
        return seen(work, handed_out(work, pool), progress)


def handed_out(work: PictureWork, pool: Executor) -> list[Part]:
    """Let a pool begin with a work; return its parts, each of which waits for its answers."""
    return [pool.submit(part).result for part in _parts(work)]


def seen(work: PictureWork, parts: Sequence[Part], progress: Progress | None) -> Seen:
    """Gather the answers to a work, those to the pictures first, as progress is told by them."""
    others = len(work.others)
    measured: list[Measured] = []
    for one in chain.from_iterable(part() for part in parts[others:]):
        measured.append(one)
        if progress is not None:
            progress(len(measured), len(work.pictures))
    return Seen(tuple(measured), tuple(answer for part in parts[:others] for answer in part()))


def _parts(work: PictureWork) -> list[Part]:
    """Return the pieces of a work, to be done by any process in any order; what takes longest stands first."""
    starts = range(0, len(work.pictures), _PICTURES_A_MESSAGE)
    return [
        *(partial(_alone, other) for other in work.others),
        *(
            partial(
                _measured,
                work.pictures[start : start + _PICTURES_A_MESSAGE],
                work.plane,
                work.settings,
                work.mask,
            )
            for start in starts
        ),
    ]


def _alone(other: Callable[[], Any]) -> list[Any]:
    return [other()]


def _measured(
    pictures: Sequence[RecordedPicture], plane: PlaneMap, settings: CurvatureSettings, mask: Mask | None
) -> list[Measured]:
    return [_measure(one, plane, settings, mask) for one in pictures]


def _measure(
    picture: RecordedPicture, plane: PlaneMap, settings: CurvatureSettings, mask: Mask | None
) -> Measured:
    try:
        image = picture.read()
        masked = None if mask is None else mask.masked(Path(picture.file).name, image)
        return measure_curvature(image, plane, settings, masked=masked)
    except (PictureError, RecordError) as error:
        # Where the run lies on this computer is no part of a result.
        reason = error.message.replace(str(picture.run / picture.file), Path(picture.file).name)
        return Unreadable(reason, damaged=isinstance(error, RecordError))
