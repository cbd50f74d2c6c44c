"""Measure many pictures in worker processes, in an order that does not depend on them; and what a run measures with."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from functools import partial
from itertools import groupby
from operator import call
from pathlib import Path
from typing import Any

from labrig.analysis.engine import map_in_order, open_process_pool
from labrig.errors import InputError, PictureError, RecordError
from labrig.protocol.sections import Scale
from labrig.protocol.yaml_file import validate_values
from labrig.record.pictures import RecordedPicture
from labrig.record.reader import Run
from labrig.vision.calibration_file import load_intrinsics, load_plane
from labrig.vision.curvature import (
    CurvatureMeasurement,
    CurvatureSettings,
    measure_curvature,
    refuse_cut_short,
)
from labrig.vision.error_budget import ErrorBudget
from labrig.vision.intrinsics import Intrinsics
from labrig.vision.picture import Mask, load_mask
from labrig.vision.plane import PlaneMap

INTRINSICS_FILE = "intrinsics.json"
PLANE_FILE = "plane.json"
MASK_FILE = "mask"

Progress = Callable[[int, int], None]


def measure_pictures(
    pictures: Sequence[RecordedPicture],
    plane: PlaneMap,
    settings: CurvatureSettings,
    mask: Mask | None,
    *,
    workers: int,
    progress: Progress | None = None,
    meanwhile: Sequence[Callable[[], Any]] = (),
) -> tuple[list[CurvatureMeasurement], list[Any]]:
    """Measure pictures of the needle, in the order given, whatever the number of workers.

    One that loses the needle, which the pictures before and after it show go on, is refused.

    Parameters
    ----------
    pictures : sequence of RecordedPicture
        One that cannot be read, or was changed, is refused with the reason.
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
    jobs: list[Callable[[], Any]] = [*meanwhile, *(partial(measure, picture) for picture in pictures)]
    workers = min(workers, len(pictures))
    with ExitStack() as held:
        answers: Iterator[Any] = map(call, jobs)
        if workers > 1:
            pool = held.enter_context(open_process_pool(workers, "measured pictures"))
            answers = map_in_order(pool, call, jobs)
        others = [next(answers) for _ in meanwhile]
        measured: list[CurvatureMeasurement] = []
        for one in answers:
            measured.append(one)
            if progress is not None:
                progress(len(measured), len(pictures))
    # The pictures of a trial are a film, in which those before and after one judge it.
    films = groupby(zip(pictures, measured, strict=True), lambda pair: pair[0].line.trial)
    return [one for _, film in films for one in refuse_cut_short([one for _, one in film])], others


def measure_picture(
    picture: RecordedPicture, plane: PlaneMap, settings: CurvatureSettings, mask: Mask | None
) -> CurvatureMeasurement:
    """Return the measurement of a recorded picture; one that cannot be read is refused."""
    try:
        return measure_curvature(picture.read(), plane, settings, mask=mask)
    except (PictureError, RecordError) as error:
        # The folder on this computer is no part of a result.
        file = picture.line.file
        return CurvatureMeasurement.refuse(error.message.replace(str(picture.run / file), Path(file).name))


def load_plane_map(run: Run) -> PlaneMap:
    """Return the plane map of a run: from its calibration files, or from the scale stated at import.

    Raises
    ------
    InputError
        When the run has neither, or its plane map was made with another lens.
    FileFormatError
        When a calibration file is malformed.
    RecordError
        When a calibration file was changed since the run began.
    """
    if PLANE_FILE in run.calibration_files:
        return load_plane(run.calibration_path(PLANE_FILE), load_lens(run))
    stated = run.protocol.get("scale")
    if not isinstance(stated, Mapping):
        raise InputError(
            f"{run.path} has no calibration/{PLANE_FILE}, so its pictures have no scale",
            "record it with a calibrated rig, or import the pictures again with --px-per-mm or --plane",
        )
    scale = validate_values(stated, f"scale of {run.path}", Scale)
    return PlaneMap.from_scale(scale.px_per_mm, scale.origin_px, scale.insertion)


def list_not_in_interval(plane: PlaneMap, budgets: Iterable[ErrorBudget | None]) -> tuple[str, ...]:
    """Return what error bars with these budgets leave out; nothing without an error bar."""
    known = [budget for budget in budgets if budget is not None]
    return plane.not_in_interval(source for budget in known for source in budget.missing) if known else ()


def load_lens(run: Run) -> Intrinsics | None:
    """Return the camera's intrinsics; None for a run without them, whose pictures are rectified."""
    if INTRINSICS_FILE not in run.calibration_files:
        return None
    return load_intrinsics(run.calibration_path(INTRINSICS_FILE))


def load_mask_of_run(run: Run) -> Mask | None:
    """Return the mask that a run began with; None without one.

    Raises
    ------
    RecordError
        When it was changed since the run began.
    InputError
        When the file is no mask.
    """
    kept = [name for name in run.calibration_files if name.startswith(f"{MASK_FILE}.")]
    return load_mask(run.calibration_path(kept[0])) if kept else None
