"""Measure many pictures in worker processes, in an order that does not depend on them."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any

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


@dataclass(frozen=True)
class Unreadable:
    """A picture that cannot be measured, and the reason."""

    reason: str


Measured = CurvatureMeasurement | Unreadable


def measure_pictures(
    pictures: Sequence[RecordedPicture],
    plane: PlaneMap,
    settings: CurvatureSettings,
    mask: Mask | None,
    *,
    workers: int,
    progress: Progress | None = None,
    meanwhile: Sequence[Callable[[], Any]] = (),
) -> tuple[list[Measured], list[Any]]:
    """Measure pictures of the needle, in the order given, whatever the number of workers.

    Parameters
    ----------
    pictures : sequence of RecordedPicture
        One that cannot be read, or was changed, gives an `Unreadable`.
    plane, settings
        How to measure them.
    mask : Mask or None
        Pixels that are not the needle.
    workers : int
        Processes; with 1 this process does the work.
    progress : callable or None
        Called with the number of finished pictures and of all.
    meanwhile : sequence of callable
        Other long calls that do not need the pictures.

    Returns
    -------
    list, list
        What each picture gave, and what each other call returned.

    Raises
    ------
    MachineError
        When worker processes die of the same picture, usually because memory ran out.
    """
    measure = partial(measure_picture, plane=plane, settings=settings, mask=mask)
    workers = min(workers, len(pictures))
    if workers <= 1:
        answers = [call() for call in meanwhile]
        return _report(map(measure, pictures), len(pictures), progress), answers
    with open_process_pool(workers, "measured pictures") as pool:
        queue = WorkQueue(pool)
        waits = [queue.begin(call) for call in meanwhile]
        starts = range(0, len(pictures), _PICTURES_A_MESSAGE)
        parts = [
            queue.begin(partial(_measure_part, measure, pictures[start : start + _PICTURES_A_MESSAGE]))
            for start in starts
        ]
        measured = _report(chain.from_iterable(part() for part in parts), len(pictures), progress)
        return measured, [wait() for wait in waits]


def _measure_part(
    measure: Callable[[RecordedPicture], Measured], pictures: Sequence[RecordedPicture]
) -> list[Measured]:
    return [measure(picture) for picture in pictures]


def _report(measured: Iterable[Measured], of: int, progress: Progress | None) -> list[Measured]:
    """Return what comes, and tell of each."""
    done = []
    for measurement in measured:
        done.append(measurement)
        if progress is not None:
            progress(len(done), of)
    return done


def measure_picture(
    picture: RecordedPicture, plane: PlaneMap, settings: CurvatureSettings, mask: Mask | None
) -> Measured:
    """Return the measurement of a recorded picture, or why there is none."""
    try:
        return measure_image(picture.read(), plane, settings, mask)
    except (PictureError, RecordError) as error:
        # The folder on this computer is no part of a result.
        reason = error.message.replace(str(picture.run / picture.file), Path(picture.file).name)
        return Unreadable(reason)


def measure_image(
    image: Picture, plane: PlaneMap, settings: CurvatureSettings, mask: Mask | None
) -> CurvatureMeasurement:
    """Return the measurement of a picture.

    Raises
    ------
    PictureError
        When the mask is of another size.
    """
    masked = None if mask is None else mask.find_masked(image)
    return measure_curvature(image, plane, settings, masked=masked)
