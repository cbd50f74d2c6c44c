"""Measure how close to their targets the insertions of a run ended, and estimate the tip along the way again.

Errors are measured in the final pictures, at the end of the shaft. The estimator then runs again over the recorded
pictures: the tip is found in each, and its pose estimated with the recorded turns. With the settings of the protocol
the estimates are those of the run; other settings (`labrig reanalyze --set estimator.observation_sd_mm=0.1`) say what
would have been estimated of the path that the needle took.
"""

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import repeat
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labrig.analysis.experiment import AnalysisRequest
from labrig.analysis.origin import find_origins
from labrig.analysis.pictures import list_not_in_interval, load_plane_map
from labrig.analysis.result import Findings, Point, Sentinel, TrialOrigin
from labrig.analysis.sentinel import check_sentinel
from labrig.errors import InputError, MeasurementRefusedError, PictureError, RecordError
from labrig.experiments.insertion.aim import Aim
from labrig.experiments.insertion.ending import (
    Ending,
    EstimatedEnd,
    TargetErrorBounds,
    decide_ending,
    judge_end,
    trace_path,
)
from labrig.experiments.insertion.events import (
    BevelTurn,
    InsertionEvent,
    InsertionRole,
    InsertionSheath,
    InsertionStart,
    InsertionStop,
    MarkersSought,
    NeedleHeld,
    TipObserved,
    TrueInsertion,
    describe_sighting,
)
from labrig.experiments.insertion.markers import FollowedMarkers, find_target_sd_mm
from labrig.experiments.insertion.protocol import InsertionProtocol
from labrig.experiments.insertion.result import InsertionResult, InsertionStep, InsertionTrial, MarkerStep
from labrig.experiments.insertion.settings import make_insertion_settings, make_out_of_plane, start_at
from labrig.record.agreement import SHARE_OF_SD
from labrig.record.events import INTERRUPTED
from labrig.record.layout import INCOMPLETE
from labrig.record.reader import Run
from labrig.steering.policy import SteeringSettings, TipSighting
from labrig.steering.problem import PlanProblem
from labrig.steering.sighting_noise import SeenInsertion, measure_noise
from labrig.steering.state import SteeringState, begin_steering, take_in_sighting, turn_bevel
from labrig.steering.tip_search import TipView, find_tip
from labrig.vision.error_budget import ErrorBudget, budget_place
from labrig.vision.marker import MarkerFix
from labrig.vision.shaft_tip import ShaftTip, measure_shaft_tip
from labrig.vision.template import load_template
from labrig.vision.tip import TipFix

FloatArray = NDArray[np.float64]

TEMPLATE_FILE = "template.png"
# Paths are only drawn, never computed with: this many points, rounded to a thousandth of a millimetre.
_PATH_POINTS, _DECIMALS = 60, 3
# The first insertions of a run tell enough about the noise of its sightings.
_MOST_NOISE_INSERTIONS = 3
_UNRECORDED: dict[str, Any] = {
    "exit_status": INCOMPLETE,
    "stop": "interrupted",
    "cause": "the run ended before the insertion did",
}


@dataclass(frozen=True, eq=False)
class _Source:
    """The run that is analysed: how its pictures are read, and the result of its grid pictures."""

    run: Run
    view: TipView
    protocol: InsertionProtocol
    sentinel: Sentinel | None

    @property
    def drift(self) -> float:
        """The relative change of scale between the grid pictures."""
        return 0.0 if self.sentinel is None else (self.sentinel.drift or 0.0)

    @property
    def bumped(self) -> str | None:
        """Why nothing is measured after the camera was bumped; None if it was not."""
        return self.sentinel.reason if self.sentinel is not None and not self.sentinel.accepted else None

    def explain(self, error: MeasurementRefusedError | PictureError | RecordError) -> str:
        """Return why a picture was not measured, with its file relative to the run."""
        return error.message.replace(f"{self.run.path}/", "")


@dataclass(frozen=True)
class _Events:
    """The recorded events of one insertion."""

    start: InsertionStart
    stop: InsertionStop
    sheath: TrialOrigin | None
    way: tuple[InsertionEvent, ...]
    true: TrueInsertion


@dataclass(frozen=True, eq=False)
class _Retraced:
    """An insertion followed again: how it was steered in the end, its steps and markers, and what was seen of it."""

    settings: SteeringSettings
    steps: Sequence[InsertionStep]
    markers: FollowedMarkers | None
    seen: SeenInsertion


def analyze(run: Run, protocol: InsertionProtocol, request: AnalysisRequest) -> Findings:
    """Measure where each insertion ended, and estimate its path again.

    Raises
    ------
    InputError
        When the run has no map from pixels to mm, or no template.
    RecordError
        When its lines are damaged.
    """
    template = load_template(run.calibration_path(TEMPLATE_FILE))
    plane = load_plane_map(run)
    sentinel = check_sentinel(protocol.sentinel, run.read_frame, run.frame_lines, plane)
    view = TipView(plane, template.relative_to(plane.insertion), request.mask)
    source = _Source(run, view, protocol, sentinel)
    trials = _read_trials(run)
    insertions, seen = list[InsertionTrial](), list[SeenInsertion]()
    for number, trial in enumerate(trials, start=1):
        retraced = _retrace(trial, source)
        insertions.append(_analyze_trial(trial, retraced, source))
        seen.append(retraced.seen)
        if request.progress is not None:
            request.progress(number, len(trials))
    steps = [step for trial in insertions for step in trial.steps if step.believed]
    scenes = [line for line in run.frame_lines if line.role == InsertionRole.SCENE]
    result = InsertionResult(
        **request.stamp.list_members(
            {"estimator": protocol.estimator.model_dump(), "planner": protocol.planner.model_dump()}
        ),
        made=len(insertions),
        arrived=sum(trial.reached is True for trial in insertions),
        causes=dict(Counter(trial.stop for trial in insertions if not trial.reached)),
        reached=_combine_reached([trial.reached for trial in insertions]),
        target_error_mm=max(_known(trial.target_error_mm for trial in insertions), default=None),
        target_error_interval_mm=max(
            (trial.target_error_interval_mm for trial in insertions if trial.target_error_interval_mm),
            key=lambda interval: interval[1],
            default=None,
        ),
        true_target_error_mm=max(_known(trial.true_target_error_mm for trial in insertions), default=None),
        true_min_clearance_mm=min(_known(trial.true_min_clearance_mm for trial in insertions), default=None),
        replans=sum(trial.replans for trial in insertions),
        length_mm=max(_known(trial.length_mm for trial in insertions), default=None),
        insertions=tuple(insertions),
        origins=find_origins(run.read_frame, scenes, plane, protocol.sheath),
        sentinel=sentinel,
        sighting_noise=measure_noise(
            seen[:_MOST_NOISE_INSERTIONS],
            _known(step.nis for step in steps),
            _restore_settings(trials[0], protocol),
        )
        if trials
        else None,
        not_in_interval=list_not_in_interval(plane, (trial.target_error_budget_mm for trial in insertions)),
    )
    return Findings(result)


def _read_trials(run: Run) -> list[_Events]:
    """Return the recorded events of each insertion that was neither made again nor left out by a person."""
    trials = run.read_trials(InsertionStart, InsertionStop)
    sheaths = {event.origin.trial: event.origin for event in run.read_events(InsertionSheath)}
    way = run.read_events(BevelTurn, TipObserved, MarkersSought, NeedleHeld)
    true = run.read_truth(TrueInsertion)
    return [
        _Events(
            trial.start,
            trial.stop or InsertionStop(trial=trial.start.trial, **_UNRECORDED),
            sheaths.get(trial.start.trial),
            tuple(event for event in way if event.trial == trial.start.trial),
            true.get(trial.start.trial, TrueInsertion(trial=trial.start.trial)),
        )
        for trial in trials
        if not trial.left_out and trial.exit_status != INTERRUPTED
    ]


def _analyze_trial(events: _Events, retraced: _Retraced, source: _Source) -> InsertionTrial:
    start, stop, truth = events.start, events.stop, events.true
    settings, steps, markers = retraced.settings, retraced.steps, retraced.markers
    tolerance_mm, target_mm = settings.problem.tolerance_mm, settings.problem.target_mm[1:]
    end, unmeasured = _measure_end(stop, source, start.roll_zero_sd_rad)
    budget = None if end is None else _find_budget(end, target_mm, source)
    bounds = _judge_end(events, retraced, source, end)
    ending = _decide_ending(events, bounds, retraced, source)
    return InsertionTrial(
        trial=start.trial,
        start_t_s=start.t_s,
        outcome=ending.outcome,
        stop=ending.stop,
        cause=ending.cause,
        reached=ending.reached,
        target_mm=start.target_mm,
        tolerance_mm=tolerance_mm,
        obstacles=start.obstacles,
        final_frame=stop.final_frame,
        replans=stop.replans,
        length_mm=None if stop.exit_status == INCOMPLETE else stop.depth_mm,
        tip_mm=None if end is None else end.tip_mm,
        shaft_mm=() if end is None else _thin_path(end.centre_line_mm),
        target_error_mm=None if end is None else math.dist(end.tip_mm, target_mm),
        sigma_target_error_mm=None if budget is None else budget.total,
        target_error_budget_mm=budget,
        unmeasured=unmeasured,
        **_describe_bounds(bounds),
        template_error_mm=math.dist(steps[-1].estimate_mm, target_mm) if steps else None,
        **truth.model_dump(include={"true_target_error_mm", "true_min_clearance_mm"}),
        true_path_mm=_thin_path(truth.path_in_plane_mm),
        missed_sightings=sum(not step.believed for step in steps),
        mean_nis=float(np.mean(nis))
        if (nis := _known(step.nis for step in steps if step.believed))
        else None,
        steps=tuple(steps),
        as_recorded=_agree(steps, events),
        marker_ids=start.marker_ids,
        marker_steps=()
        if markers is None
        else tuple(
            MarkerStep(
                frame=event.frame, depth_mm=event.depth_mm, **marker.model_dump(exclude={"corners_px"})
            )
            for event in markers.sought
            for marker in event.markers
        ),
    )


def _describe_bounds(bounds: TargetErrorBounds | None) -> dict[str, Any]:
    if bounds is None:
        return {}
    return {
        "target_error_interval_mm": bounds.interval_mm,
        "target_error_interval_by": bounds.by,
        "target_error_interval_tip_mm": bounds.tip_mm,
        "target_error_sources_mm": bounds.sources,
        "depth": bounds.depth,
    }


def _agree(steps: Sequence[InsertionStep], events: _Events) -> bool:
    """Return whether every estimate is the recorded one, as closely as two processors agree."""
    recorded = (event for event in events.way if isinstance(event, TipObserved))
    return all(
        math.dist(step.estimate_mm, before.estimate_mm) <= SHARE_OF_SD * step.position_sd_mm
        for step, before in zip(steps, recorded, strict=True)
    )


def _restore_settings(events: _Events, protocol: InsertionProtocol) -> SteeringSettings:
    try:
        asked = make_insertion_settings(protocol, events.start.target_mm, events.start.obstacles)
    except InputError:  # an insertion that ended before it was planned: its target lies in an obstacle
        asked = make_insertion_settings(protocol, events.start.target_mm, ())
    return start_at(asked, events.sheath)


def _judge_end(
    events: _Events, retraced: _Retraced, source: _Source, shaft: ShaftTip | None
) -> TargetErrorBounds | None:
    """Return the distance in space from the target; None if nothing was seen, or the camera was bumped."""
    start, stop, settings = events.start, events.stop, retraced.settings
    if stop.exit_status == INCOMPLETE or source.bumped is not None:
        return None
    turns = [event for event in events.way if isinstance(event, BevelTurn)]
    last = retraced.steps[-1] if retraced.steps else None
    return judge_end(
        trace_path(turns, start.roll_zero_rad, stop.depth_mm, stop.centred, settings.policy.backlash_mm),
        settings,
        make_out_of_plane(source.protocol, start.roll_zero_sd_rad, start.torsion),
        source.view.plane,
        find_target_sd_mm(source.protocol, retraced.markers),
        shaft=shaft,
        estimate=None if last is None else EstimatedEnd(np.array(last.estimate_mm), last.position_sd_mm),
        drift=source.drift,
    )


def _decide_ending(
    events: _Events, bounds: TargetErrorBounds | None, retraced: _Retraced, source: _Source
) -> Ending:
    """Return how an insertion ended: as the live one was decided, unless the camera was bumped."""
    stop, held = events.stop, next((event for event in events.way if isinstance(event, NeedleHeld)), None)
    if held is None or stop.exit_status == INCOMPLETE:
        return Ending(stop.outcome, str(stop.stop), stop.cause)
    doubt = None if retraced.markers is None else retraced.markers.doubt
    if source.bumped is not None:
        doubt = Ending("unknown", "camera_bumped", source.bumped)
    tolerance_mm = retraced.settings.problem.tolerance_mm
    return decide_ending(str(held.stop), held.detail, bounds, tolerance_mm, doubt)


def _retrace(events: _Events, source: _Source) -> _Retraced:
    """Find tip and markers again in each picture, and estimate the tip's pose with the recorded turns."""
    start, settings = events.start, _restore_settings(events, source.protocol)
    aim, markers = (
        Aim(start.target_mm, start.obstacles),
        FollowedMarkers.of(source.protocol, source.view.plane),
    )
    begun = state = begin_steering(settings)
    steps, way = list[InsertionStep](), list[TipSighting | float]()
    depths_mm = [event.depth_mm for event in events.way if isinstance(event, TipObserved)]
    truths = _list_truths(events.true.path_in_plane_mm, depths_mm)
    for event in events.way:
        if isinstance(event, MarkersSought) and markers is not None:
            found = [
                MarkerFix(
                    marker.marker_id,
                    None if marker.corners_px is None else np.array(marker.corners_px),
                    marker.reason,
                )
                for marker in event.markers
            ]
            markers = markers.take(found, event.trial, event.frame, event.depth_mm)
            settings, _ = markers.place(settings, aim)
        elif isinstance(event, BevelTurn):
            way.append(event.to_rad - event.from_rad)
            state = turn_bevel(state, event.to_rad - event.from_rad, settings)
        elif isinstance(event, TipObserved):
            predicted = state.predict(event.depth_mm, settings)
            fix, seen_mm = _find_tip_again(event, predicted, state, source)
            state = take_in_sighting(state, TipSighting(event.depth_mm, seen_mm), settings)
            way.append(TipSighting(event.depth_mm, seen_mm if state.tip.accepted else None))
            steps.append(
                InsertionStep(
                    frame=event.frame,
                    t_s=event.t_s,
                    **describe_sighting(fix, seen_mm, predicted[:3, 3], state),
                    clearance_mm=_find_clearance_mm(state.tip.position_mm, settings.problem),
                    **next(truths),
                )
            )
    return _Retraced(settings, steps, markers, SeenInsertion(begun, tuple(way)))


def _list_truths(path_mm: FloatArray, depths_mm: Sequence[float]) -> Iterator[dict[str, Any]]:
    """Return the true place and heading at insertion lengths on a path (N, 2); None for both without a path."""
    if len(path_mm) < 2:
        return repeat({"true_mm": None, "true_heading_rad": None})
    rises_mm = np.diff(path_mm, axis=0)
    arc_mm = np.concatenate(([0.0], np.cumsum(np.linalg.norm(rises_mm, axis=1))))
    places = np.column_stack([np.interp(depths_mm, arc_mm, along) for along in path_mm.T]).tolist()
    at = np.clip(np.searchsorted(arc_mm, depths_mm), 1, len(rises_mm)) - 1
    headings_rad = np.arctan2(*rises_mm[at].T).tolist()
    return (
        {"true_mm": tuple(place), "true_heading_rad": heading}
        for place, heading in zip(places, headings_rad, strict=True)
    )


def _find_tip_again(
    event: TipObserved, predicted: FloatArray, state: SteeringState, source: _Source
) -> tuple[TipFix, FloatArray | None]:
    """Find the tip in a recorded picture, as a live insertion does."""
    picture = source.run.pictures.places[event.frame]
    try:
        image = picture.read()
        found = find_tip(source.view, image, predicted, state.tip, event.bevel_rad)
    except (PictureError, RecordError) as error:
        return TipFix(accepted=False, reason=source.explain(error)), None
    return found.fix, found.position_mm


def _find_clearance_mm(position_mm: FloatArray, problem: PlanProblem) -> float | None:
    """Return the distance from the needle's surface at the tip to the surface of the nearest obstacle."""
    apart = [
        math.dist(position_mm, obstacle.position_mm) - obstacle.radius_mm for obstacle in problem.obstacles
    ]
    return min(apart) - problem.diameter_mm / 2 if apart else None


def _measure_end(
    stop: InsertionStop, source: _Source, roll_sd_rad: float
) -> tuple[ShaftTip | None, str | None]:
    """Measure the shaft in the final picture; without a measurement, return the reason."""
    if stop.final_frame is None:
        return None, "there is no final picture"
    if source.bumped is not None:
        return None, source.bumped
    picture = source.run.pictures.places[stop.final_frame]
    try:
        image, mask, protocol = picture.read(), source.view.mask, source.protocol
        shaft = measure_shaft_tip(
            image,
            source.view.plane,
            protocol.needle.diameter_mm,
            protocol.sheath.diameter_mm,
            mask=mask,
            roll_sd_rad=roll_sd_rad,
        )
    except (MeasurementRefusedError, PictureError, RecordError) as error:
        return None, source.explain(error)
    return shaft, None


def _find_budget(end: ShaftTip, target_mm: tuple[float, float], source: _Source) -> ErrorBudget:
    """Return the error budget of the distance from the target to the end of the shaft.

    The drift between the grid pictures scales with the distance from the origin, and is a part of the plane's.
    """
    tip_mm = np.array(end.tip_mm)
    towards = tip_mm - target_mm
    towards = towards / max(float(np.linalg.norm(towards)), 1e-9)
    budget = budget_place(source.view.plane, end.tip_px, end.errors, towards)
    return budget.with_drift(source.drift * float(np.linalg.norm(tip_mm)))


def _thin_path(path: FloatArray) -> tuple[Point, ...]:
    """Return a path (N, 2) thinned for drawing, with both ends."""
    kept = np.linspace(0, len(path) - 1, min(len(path), _PATH_POINTS)).round().astype(int)
    return tuple((y, z) for y, z in np.round(path[kept], _DECIMALS).tolist())


def _combine_reached(reached: Sequence[bool | None]) -> bool | None:
    """Return whether every target was reached: False without an insertion, None if none was missed and one is open."""
    if not reached or False in reached:
        return False
    return None if None in reached else True


def _known(values: Iterable[float | None]) -> list[float]:
    return [value for value in values if value is not None]
