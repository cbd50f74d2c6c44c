"""Radii of curvature in every picture of the needle, of a steerability run or imported."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from types import MappingProxyType

from labrig.analysis.experiment import AnalysisRequest
from labrig.analysis.origin import ReadFrame, find_origins
from labrig.analysis.pictures import (
    list_not_in_interval,
    load_plane_map,
    measure_pictures,
)
from labrig.analysis.result import Findings, TrialOrigin, save_centre_lines
from labrig.analysis.sentinel import check_sentinel
from labrig.experiments.shared.curvature_result import CurvatureResult, PictureResult
from labrig.experiments.shared.grouping import average_means, find_final_pictures, summarise_specimens
from labrig.experiments.shared.needle_events import DrawnRadius, NeedleRole, SpecimenTrialStart
from labrig.experiments.shared.picture_results import complete_picture
from labrig.protocol.sections import AnalysisWindow, GridSentinel, NeedleInPicture, Sheath
from labrig.record.events import INTERRUPTED, FrameLine, PictureRole, TrialStop
from labrig.record.reader import Pictures, Run
from labrig.vision.curvature import CurvatureMeasurement, CurvatureSettings
from labrig.vision.picture import Picture
from labrig.vision.plane import PlaneMap

_OF_THE_TRIAL = {"trial", "specimen", "gelatin_percent", "hole", "needle_id"}
MEASURED_ROLES = (NeedleRole.ADVANCE, NeedleRole.FINAL, NeedleRole.IMPORTED)
"""Of the pictures that are measured."""


@dataclass(frozen=True)
class _Picture:
    """A recorded picture with its trial; None for a picture without a trial."""

    line: FrameLine
    trial: SpecimenTrialStart | None


@dataclass(frozen=True)
class CurvatureOrder:
    """The settings of a protocol for measuring the pictures of its needle.

    Attributes
    ----------
    needle : NeedleInPicture
        The needle and the sheath in the pictures.
    window : AnalysisWindow
        Which part of the shaft is fitted, and what is accepted.
    sheath : Sheath or None
        The sheath, from which each trial's origin is found; None for pictures without trials.
    sheath_role : PictureRole or None
        The role of pictures that show only the sheath.
    sentinel : GridSentinel or None
        The graph paper before and after the run.
    """

    needle: NeedleInPicture
    window: AnalysisWindow
    sheath: Sheath | None = None
    sheath_role: PictureRole | None = None
    sentinel: GridSentinel | None = None

    @property
    def settings(self) -> CurvatureSettings:
        """The settings of a measurement."""
        return CurvatureSettings(
            needle_diameter_mm=self.needle.diameter_mm,
            sheath_diameter_mm=self.needle.sheath_diameter_mm,
            **self.window.model_dump(),
        )


def analyze_curvature(run: Run, order: CurvatureOrder, request: AnalysisRequest) -> Findings:
    """Measure the pictures, and group them, with the truth beside them if it is recorded.

    The intervals of the groups and of single pictures include the uncertainty of the bevel's roll.

    Raises
    ------
    InputError
        When the run has no map from pixels to mm.
    """
    settings, roll_sd_deg, mask = order.settings, order.window.roll_sd_deg, request.mask
    trials = _list_trials(run)
    pictures = _list_pictures(run, trials)
    places = tuple(run.pictures.places[picture.line.frame] for picture in pictures)
    plane, read, recorded = load_plane_map(run), partial(_get_picture, run.pictures), run.frame_lines
    sheaths = [line for line in recorded if line.role == order.sheath_role]
    others = (
        partial(_find_origins, order.sheath, read, sheaths, plane),
        partial(check_sentinel, order.sentinel, read, recorded, plane),
    )
    measured, (origins, sentinel) = measure_pictures(
        places, plane, settings, mask, workers=request.workers, progress=request.progress, meanwhile=others
    )
    by_trial, drawn_mm = {origin.trial: origin for origin in origins}, _read_drawn_radii(run)
    results = tuple(
        complete_picture(
            describe_picture(picture.line, picture.trial, measurement, drawn_mm),
            None if picture.trial is None else by_trial.get(picture.trial.trial),
            sentinel,
        )
        for picture, measurement in zip(pictures, measured, strict=True)
    )
    finals = find_final_pictures(results)
    specimens = summarise_specimens(trials, finals, roll_sd_deg, drawn_mm)
    content = CurvatureResult(
        **request.stamp.list_members(settings),
        specimens=specimens,
        mean_radius_mm=average_means(specimens),
        measurements=results,
        origins=origins,
        sentinel=sentinel,
        not_in_interval=list_not_in_interval(plane, (result.radius_budget_mm for result in results)),
    )
    lines = {
        picture.line.frame: measurement.line
        for picture, measurement in zip(pictures, measured, strict=True)
        if measurement.line is not None
    }
    return Findings(content, partial(save_centre_lines, lines))


def _get_picture(frames: Pictures, frame: int) -> Picture:
    return frames[frame]


def _find_origins(
    sheath: Sheath | None, read: ReadFrame, lines: Sequence[FrameLine], plane: PlaneMap
) -> tuple[TrialOrigin, ...]:
    """Return the origin of each trial; imported pictures have no trials, and an origin of their own."""
    return () if sheath is None else find_origins(read, lines, plane, sheath)


def _list_trials(run: Run) -> list[SpecimenTrialStart]:
    # An interrupted trial was repeated as another trial, as was one that a person had made again.
    recorded = run.read_trials(SpecimenTrialStart, TrialStop)
    return [trial.start for trial in recorded if trial.exit_status != INTERRUPTED and not trial.left_out]


def _list_pictures(run: Run, trials: Sequence[SpecimenTrialStart]) -> list[_Picture]:
    by_number = {trial.trial: trial for trial in trials}
    return [
        _Picture(line, None if line.trial is None else by_number.get(line.trial))
        for line in run.frame_lines
        if line.role in MEASURED_ROLES
    ]


def _read_drawn_radii(run: Run) -> dict[int, float]:
    drawn = run.read_truth(DrawnRadius)
    return {trial: line.radius_mm for trial, line in drawn.items() if line.radius_mm is not None}


def describe_picture(
    line: FrameLine,
    trial: SpecimenTrialStart | None,
    measured: CurvatureMeasurement,
    drawn_mm: Mapping[int, float] = MappingProxyType({}),
) -> PictureResult:
    """Return the result of a measured picture of a trial, if it belongs to one; `drawn_mm` has the true radii."""
    place = {
        "frame": line.frame,
        "image": line.source or line.file,
        "role": line.role,
        **dict.fromkeys(_OF_THE_TRIAL),
        **({} if trial is None else trial.model_dump(include=_OF_THE_TRIAL)),
        "insertion_mm": line.insertion_mm,
        "true_radius_mm": None if trial is None else drawn_mm.get(trial.trial),
    }
    return PictureResult(**place, **measured.model_dump())
