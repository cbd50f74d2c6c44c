"""Radii of curvature in every picture of the needle, of a steerability run or imported."""

from collections.abc import Mapping
from functools import partial
from types import MappingProxyType
from typing import Protocol

from labrig.analysis.experiment import AnalysisRequest
from labrig.analysis.origin import find_origins
from labrig.analysis.pictures import list_not_in_interval, load_plane_map, measure_pictures
from labrig.analysis.result import Findings, TrialOrigin, save_centre_lines
from labrig.analysis.sentinel import check_sentinel
from labrig.experiments.shared.curvature_result import CurvatureResult, PictureResult
from labrig.experiments.shared.grouping import average_means, find_final_pictures, summarise_specimens
from labrig.experiments.shared.needle_events import DrawnRadius, NeedleRole, SpecimenTrialStart
from labrig.experiments.shared.picture_results import complete_picture
from labrig.protocol.sections import AnalysisWindow, NeedleInPicture
from labrig.record.events import INTERRUPTED, FrameLine, TrialStop
from labrig.record.reader import Run
from labrig.vision.curvature import CurvatureMeasurement, CurvatureSettings
from labrig.vision.plane import PlaneMap

_OF_THE_TRIAL = {"trial", "specimen", "gelatin_percent", "hole", "needle_id"}
MEASURED_ROLES = (NeedleRole.ADVANCE, NeedleRole.FINAL, NeedleRole.IMPORTED)
"""Of the pictures that are measured."""


class MeasuredProtocol(Protocol):
    """A protocol whose pictures show a needle; `sheath` and `sentinel` are of one with trials."""

    @property
    def pictured_needle(self) -> NeedleInPicture:
        """Needle and sheath in the pictures."""

    @property
    def analysis(self) -> AnalysisWindow:
        """Which part of the shaft is fitted, and what is accepted."""


def make_settings(protocol: MeasuredProtocol) -> CurvatureSettings:
    """Return the settings by which the pictures of a protocol are measured."""
    needle, window = protocol.pictured_needle, protocol.analysis
    return CurvatureSettings(
        needle_diameter_mm=needle.diameter_mm,
        sheath_diameter_mm=needle.sheath_diameter_mm,
        **window.model_dump(),
    )


def analyze(run: Run, protocol: MeasuredProtocol, request: AnalysisRequest) -> Findings:
    """Measure the pictures, and group them, with the truth beside them if it is recorded.

    The intervals of the groups and of single pictures include the uncertainty of the bevel's roll.

    Raises
    ------
    InputError
        When the run has no map from pixels to mm.
    """
    settings, roll_sd_deg = make_settings(protocol), protocol.analysis.roll_sd_deg
    # An interrupted trial was repeated as another trial, as was one that a person had made again: neither is counted.
    # One that never ended will be repeated: it counts, and is not measured.
    recorded = run.read_trials(SpecimenTrialStart, TrialStop)
    kept = [trial for trial in recorded if trial.exit_status != INTERRUPTED and not trial.left_out]
    trials: dict[int | None, SpecimenTrialStart] = {one.start.trial: one.start for one in kept if one.stop}
    starts = [trial.start for trial in kept]
    counted = [line for line in run.frame_lines if line.trial in trials or not recorded]
    lines, plane = [line for line in counted if line.role in MEASURED_ROLES], load_plane_map(run)
    measured, (origins, sentinel) = measure_pictures(
        tuple(run.pictures.places[line.frame] for line in lines),
        plane,
        settings,
        request.mask,
        workers=request.workers,
        progress=request.progress,
        meanwhile=(
            partial(_find_origins, run, protocol, plane),
            partial(
                check_sentinel,
                getattr(protocol, "sentinel", None),
                run.pictures.__getitem__,
                run.frame_lines,
                plane,
            ),
        ),
    )
    by_trial: dict[int | None, TrialOrigin] = {origin.trial: origin for origin in origins}
    truth = run.read_truth(DrawnRadius).items()
    drawn_mm = {trial: line.radius_mm for trial, line in truth if line.radius_mm is not None}
    results = tuple(
        complete_picture(
            describe_picture(line, trials.get(line.trial), measurement, drawn_mm),
            by_trial.get(line.trial),
            sentinel,
        )
        for line, measurement in zip(lines, measured, strict=True)
    )
    specimens = summarise_specimens(starts, find_final_pictures(results), roll_sd_deg, drawn_mm)
    content = CurvatureResult(
        **request.stamp.list_members(settings),
        specimens=specimens,
        mean_radius_mm=average_means(specimens),
        measurements=results,
        origins=origins,
        sentinel=sentinel,
        not_in_interval=list_not_in_interval(plane, (result.radius_budget_mm for result in results)),
    )
    shafts = {line.frame: one.line for line, one in zip(lines, measured, strict=True) if one.line is not None}
    return Findings(content, partial(save_centre_lines, shafts))


def _find_origins(run: Run, protocol: MeasuredProtocol, plane: PlaneMap) -> tuple[TrialOrigin, ...]:
    """Return the origin of each trial; imported pictures have no trials, and an origin of their own."""
    sheath = getattr(protocol, "sheath", None)
    shown = [line for line in run.frame_lines if line.role == NeedleRole.SHEATH]
    return () if sheath is None else find_origins(run.pictures.__getitem__, shown, plane, sheath)


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
