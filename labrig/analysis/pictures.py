"""Measure many pictures in worker processes, in an order that does not depend on them."""

from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any, TypeAlias, TypeVar

from labrig.analysis.engine import WorkQueue, open_process_pool
from labrig.errors import PictureError, RecordError
from labrig.record.pictures import RecordedPicture
from labrig.vision.curvature import CurvatureMeasurement, CurvatureSettings, measure_curvature
from labrig.vision.mask import Mask
from labrig.vision.picture import Picture
from labrig.vision.plane import PlaneMap

Progress = Callable[[int, int], None]
# Enough to keep a worker busy between messages, few enough for a steady progress bar.
_PICTURES_A_MESSAGE = 4

_Result = TypeVar("_Result")


@dataclass(frozen=True)
class Unreadable:
    """A picture that cannot be measured, and the reason; `damaged` if it is missing or was changed."""

    reason: str
    damaged: bool = False


Measured = CurvatureMeasurement | Unreadable


@dataclass(frozen=True)
class PictureWork:
    """What an analysis needs before it can continue.

    Attributes
    ----------
    pictures : tuple of RecordedPicture
        Pictures of the needle. One that cannot be read, or was changed, gives an `Unreadable`.
    plane, settings
        How to measure them.
    mask : Mask or None
        Pixels that are not the needle.
    others : tuple of callable
        Other long calls that can run meanwhile; each is pickled and called in another process.
    """

    pictures: tuple[RecordedPicture, ...]
    plane: PlaneMap
    settings: CurvatureSettings
    mask: Mask | None = None
    others: tuple[Callable[[], Any], ...] = ()


@dataclass(frozen=True)
class PictureAnswers:
    """The measurement of each picture and the answer of each other call, in order."""

    measured: tuple[Measured, ...]
    others: tuple[Any, ...]


Analysis: TypeAlias = Generator[PictureWork, PictureAnswers, _Result]
"""An analysis that asks for pictures to be measured and continues with the answers."""

Part: TypeAlias = Callable[[], list[Any]]
"""A part of a work: returns its answers, or waits for them."""


def finish_analysis(
    analysis: Analysis[_Result],
    look: Callable[[PictureWork], PictureAnswers],
    answer: PictureAnswers | None = None,
) -> _Result:
    """Return the result of an analysis; `look` does the work that it asks for.

    Parameters
    ----------
    answer : PictureAnswers or None
        The answers to the work that it has asked for already; None if it has not begun.
    """
    try:
        while True:
            answer = look(next(analysis) if answer is None else analysis.send(answer))
    except StopIteration as done:
        result: _Result = done.value
        return result


def measure_pictures(work: PictureWork, workers: int, progress: Progress | None) -> PictureAnswers:
    """Measure every picture, in the order given, whatever the number of workers.

    Parameters
    ----------
    workers : int
        Processes; with 1 this process does the work.
    progress : callable or None
        Called with the number of finished pictures and of all.

    Raises
    ------
    MachineError
        When worker processes die of the same picture, usually because memory ran out.
    """
    workers = min(workers, len(work.pictures))
    if workers <= 1:
        return gather_answers(work, split_work(work), progress)
    with open_process_pool(workers, "measured pictures") as pool:
        return gather_answers(work, submit_work(work, WorkQueue(pool)), progress)


def submit_work(work: PictureWork, queue: WorkQueue) -> list[Part]:
    """Submit a work; return its parts, each of which waits for its answers."""
    return [queue.begin(part) for part in split_work(work)]


def gather_answers(work: PictureWork, parts: Sequence[Part], progress: Progress | None) -> PictureAnswers:
    """Gather the answers to a work, those of the pictures first, because they drive the progress."""
    others = len(work.others)
    measured: list[Measured] = []
    for measurement in chain.from_iterable(part() for part in parts[others:]):
        measured.append(measurement)
        if progress is not None:
            progress(len(measured), len(work.pictures))
    return PictureAnswers(tuple(measured), tuple(answer for part in parts[:others] for answer in part()))


def split_work(work: PictureWork) -> list[Part]:
    """Return the parts of a work for any process in any order; those that take longest come first."""
    how = (work.plane, work.settings, work.mask)
    starts = range(0, len(work.pictures), _PICTURES_A_MESSAGE)
    return [
        *(partial(_call_one, other) for other in work.others),
        *(
            partial(_measure_part, work.pictures[start : start + _PICTURES_A_MESSAGE], *how)
            for start in starts
        ),
    ]


def _call_one(other: Callable[[], Any]) -> list[Any]:
    return [other()]


def _measure_part(
    pictures: Sequence[RecordedPicture], plane: PlaneMap, settings: CurvatureSettings, mask: Mask | None
) -> list[Measured]:
    return [measure_picture(picture, plane, settings, mask) for picture in pictures]


def measure_picture(
    picture: RecordedPicture, plane: PlaneMap, settings: CurvatureSettings, mask: Mask | None
) -> Measured:
    """Return the measurement of a recorded picture, or why there is none."""
    try:
        return measure_image(picture.read(), Path(picture.file).name, plane, settings, mask)
    except (PictureError, RecordError) as error:
        # The folder on this computer is no part of a result.
        reason = error.message.replace(str(picture.run / picture.file), Path(picture.file).name)
        return Unreadable(reason, damaged=isinstance(error, RecordError))


def measure_image(
    image: Picture, name: str, plane: PlaneMap, settings: CurvatureSettings, mask: Mask | None
) -> CurvatureMeasurement:
    """Return the measurement of a picture; `name` is that of its file, by which a mask may know it.

    Raises
    ------
    PictureError
        When the mask is of another size.
    """
    masked = None if mask is None else mask.find_masked(name, image)
    return measure_curvature(image, plane, settings, masked=masked)
