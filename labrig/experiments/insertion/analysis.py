"""Measure how close to their targets the insertions of a run ended, and estimate the tip along the way again.

Errors are measured in the final pictures, at the end of the shaft. The estimator then runs again over the recorded
pictures: the tip is found in each, and its pose estimated with the recorded turns. With the settings of the protocol
the estimates are those of the run; other settings (`labrig reanalyze --set estimator.observation_sd_mm=0.1`) say what
would have been estimated of the path that the needle took.
"""

import math
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labrig.analysis.experiment import AnalysisRequest
from labrig.analysis.origin import find_origins
from labrig.analysis.pictures import list_not_in_interval, load_plane_map
from labrig.analysis.result import Findings, Point, Sentinel, TrialOrigin
from labrig.analysis.sentinel import check_sentinel
from labrig.errors import InputError, MeasurementRefusedError, PictureError, RecordError
from labrig.experiments.insertion.ending import (
    TEMPLATE_BIAS_MM,
    Ending,
    EstimatedEnd,
    TargetErrorBounds,
    TracedPath,
    judge_end,
)
from labrig.experiments.insertion.events import (
    BevelTurn,
    InsertionEvent,
    InsertionRole,
    InsertionSheath,
    InsertionStart,
    InsertionStop,
    MarkersSought,
    TipObserved,
    TrueInsertion,
    describe_sighting,
)
from labrig.experiments.insertion.marker_history import MarkerHistory, follow_recorded
from labrig.experiments.insertion.marker_view import find_target_sd_mm
from labrig.experiments.insertion.protocol import InsertionProtocol
from labrig.experiments.insertion.result import InsertionResult, InsertionStep, InsertionTrial, SightingNoise
from labrig.experiments.insertion.settings import (
    make_insertion_settings,
    make_out_of_plane,
    restore_settings,
    with_observation_sd,
)
from labrig.record.agreement import SHARE_OF_SD
from labrig.record.events import INTERRUPTED
from labrig.record.layout import INCOMPLETE
from labrig.record.reader import Run
from labrig.steering.policy import SteeringSettings, TipSighting
from labrig.steering.problem import PlanProblem
from labrig.steering.sighting_noise import SeenInsertion, judge_nis, measure_backlash, measure_sighting_sd
from labrig.steering.state import SteeringState, begin_steering, take_in_sighting, turn_bevel
from labrig.steering.tip_search import TipView, find_tip
from labrig.vision.error_budget import ErrorBudget, budget_place
from labrig.vision.shaft_tip import ShaftTip, measure_shaft_tip
from labrig.vision.template import load_template
from labrig.vision.tip import TipFix

FloatArray = NDArray[np.float64]

TEMPLATE_FILE = "template.png"
# Paths are only drawn, never computed with: this many points, rounded to a thousandth of a millimetre.
_PATH_POINTS, _DECIMALS = 60, 3
# The first insertions of a run tell enough about the noise of its sightings.
_MOST_NOISE_INSERTIONS = 3
# The template shows so much of the tip. While the bend swings over inside it, the tip is read off its place.
_TEMPLATE_MM = 4.0


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
    markers: tuple[MarkersSought, ...] = ()


class _TruePath:
    """The needle's true path in the simulated world, (N, 2) as (y, z), with the arc length at each point."""

    def __init__(self, truth: TrueInsertion) -> None:
        path = np.asarray(truth.path_mm, dtype=np.float64).reshape(-1, 3)
        steps_mm = np.linalg.norm(np.diff(path, axis=0), axis=1)
        self.path_mm = path[:, 1:]
        self._arc_mm = np.concatenate((np.zeros(min(len(path), 1)), np.cumsum(steps_mm)))

    def at(self, depth_mm: float) -> tuple[Point | None, float | None]:
        """Return position and heading at an insertion length; None for both without a path."""
        if len(self.path_mm) < 2:
            return None, None
        y, z = (float(np.interp(depth_mm, self._arc_mm, along)) for along in self.path_mm.T)
        index = int(np.clip(np.searchsorted(self._arc_mm, depth_mm), 1, len(self._arc_mm) - 1))
        rise = self.path_mm[index] - self.path_mm[index - 1]
        return (y, z), math.atan2(rise[0], rise[1])


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
    insertions = []
    for number, trial in enumerate(trials, start=1):
        insertions.append(_analyze_trial(trial, source))
        if request.progress is not None:
            request.progress(number, len(trials))
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
        target_error_interval_mm=_find_widest([trial.target_error_interval_mm for trial in insertions]),
        true_target_error_mm=max(_known(trial.true_target_error_mm for trial in insertions), default=None),
        true_min_clearance_mm=min(_known(trial.true_min_clearance_mm for trial in insertions), default=None),
        replans=sum(trial.replans for trial in insertions),
        length_mm=max(_known(trial.length_mm for trial in insertions), default=None),
        insertions=tuple(insertions),
        origins=find_origins(run.read_frame, scenes, plane, protocol.sheath),
        sentinel=sentinel,
        sighting_noise=_measure_noise(trials, insertions, protocol),
        not_in_interval=list_not_in_interval(plane, (trial.target_error_budget_mm for trial in insertions)),
    )
    return Findings(result)


def _read_trials(run: Run) -> list[_Events]:
    """Return the recorded events of each insertion that was neither made again nor left out by a person."""
    trials = run.read_trials(InsertionStart, InsertionStop)
    sheaths = {event.origin.trial: event.origin for event in run.read_events(InsertionSheath)}
    way = run.read_events(BevelTurn, TipObserved)
    markers = run.read_events(MarkersSought)
    true = run.read_truth(TrueInsertion)
    return [
        _Events(
            trial.start,
            trial.stop or _stop_unrecorded(trial.start.trial),
            sheaths.get(trial.start.trial),
            tuple(event for event in way if event.trial == trial.start.trial),
            true.get(trial.start.trial, TrueInsertion(trial=trial.start.trial)),
            tuple(event for event in markers if event.trial == trial.start.trial),
        )
        for trial in trials
        if not trial.left_out and trial.exit_status != INTERRUPTED
    ]


def _stop_unrecorded(trial: int) -> InsertionStop:
    cause = "the run ended before the insertion did"
    return InsertionStop(trial=trial, exit_status=INCOMPLETE, stop="interrupted", cause=cause)


def _analyze_trial(events: _Events, source: _Source) -> InsertionTrial:
    start, stop, truth = events.start, events.stop, events.true
    settings, true = _restore_settings(events, source.protocol), _TruePath(truth)
    markers = follow_recorded(source.protocol, source.view.plane, start, events.markers)
    steps = _retrace(events, settings, source, true, markers)
    settings = markers.place_at_end(settings)
    tolerance_mm, target_mm = settings.problem.tolerance_mm, settings.problem.target_mm[1:]
    end, unmeasured = _measure_end(stop, source, start.roll_zero_sd_rad)
    budget = None if end is None else _find_budget(end, target_mm, source)
    bounds = _judge_end(events, settings, source, end, steps=steps, markers=markers)
    ending = _decide_ending(stop, bounds, _find_doubt(source, markers), tolerance_mm)
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
        true_path_mm=_thin_path(true.path_mm),
        missed_sightings=sum(not step.believed for step in steps),
        mean_nis=_average(_known(step.nis for step in steps if step.believed)),
        steps=tuple(steps),
        as_recorded=_agree(steps, events),
        marker_ids=start.marker_ids,
        marker_steps=markers.steps,
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
    return restore_settings(asked, events.sheath)


def _judge_end(
    events: _Events,
    settings: SteeringSettings,
    source: _Source,
    shaft: ShaftTip | None,
    *,
    steps: Sequence[InsertionStep],
    markers: MarkerHistory,
) -> TargetErrorBounds | None:
    """Return the distance in space from the target; None if nothing was seen, or the camera was bumped."""
    start, stop = events.start, events.stop
    if stop.exit_status == INCOMPLETE or source.bumped is not None:
        return None
    turns = [event for event in events.way if isinstance(event, BevelTurn)]
    last = steps[-1] if steps else None
    return judge_end(
        TracedPath.of_turns(
            turns, start.roll_zero_rad, stop.depth_mm, stop.centred, settings.policy.backlash_mm
        ),
        settings,
        make_out_of_plane(source.protocol, start.roll_zero_sd_rad, start.torsion),
        source.view.plane,
        find_target_sd_mm(source.protocol, markers.last),
        shaft=shaft,
        estimate=None if last is None else EstimatedEnd(np.array(last.estimate_mm), last.position_sd_mm),
        drift=source.drift,
    )


def _find_doubt(source: _Source, markers: MarkerHistory) -> Ending | None:
    """Return the ending of an insertion after which camera or markers are not where they were, None otherwise."""
    if source.bumped is not None:
        return Ending("unknown", "camera_bumped", source.bumped)
    doubt = None if markers.last is None else markers.last.doubt
    return None if doubt is None else Ending("stopped", doubt.reason, doubt.detail)


def _decide_ending(
    stop: InsertionStop, bounds: TargetErrorBounds | None, doubt: Ending | None, tolerance_mm: float
) -> Ending:
    """Return how an insertion ended: as steered, unless camera or markers were moved or the shaft shows otherwise."""
    if stop.outcome in ("reached", "reached_in_plane_only"):
        if doubt is not None:
            return doubt
        if bounds is not None:
            return bounds.decide(tolerance_mm)
    return Ending(stop.outcome, str(stop.stop), stop.cause)


def _retrace(
    events: _Events, settings: SteeringSettings, source: _Source, true: _TruePath, markers: MarkerHistory
) -> list[InsertionStep]:
    """Find the tip again in each picture, and estimate its pose with the recorded turns."""
    settings = markers.place_before(events.way, settings)
    state, steps = begin_steering(settings), list[InsertionStep]()
    for event in events.way:
        if isinstance(event, BevelTurn):
            state = turn_bevel(state, event.to_rad - event.from_rad, settings)
        elif isinstance(event, TipObserved):
            predicted = state.predict(event.depth_mm, settings)
            fix, seen_mm = _find_tip_again(event, predicted, state, source)
            settings = markers.place_at(event.frame, settings)
            state = take_in_sighting(state, TipSighting(event.depth_mm, seen_mm), settings)
            true_mm, true_heading_rad = true.at(state.insertion_mm)
            steps.append(
                InsertionStep(
                    frame=event.frame,
                    t_s=event.t_s,
                    **describe_sighting(fix, seen_mm, predicted[:3, 3], state),
                    clearance_mm=_find_clearance_mm(state.tip.position_mm, settings.problem),
                    true_mm=true_mm,
                    true_heading_rad=true_heading_rad,
                )
            )
    return steps


def _measure_noise(
    trials: Sequence[_Events], insertions: Sequence[InsertionTrial], protocol: InsertionProtocol
) -> SightingNoise | None:
    """Return whether the stated noise of the sightings fits, and what it is; None for too few sightings."""
    nis = [step.nis for trial in insertions for step in trial.steps if step.believed and step.nis is not None]
    judged = judge_nis(nis, observed=2)
    if judged is None:
        return None
    told = list(zip(trials[:_MOST_NOISE_INSERTIONS], insertions, strict=False))
    stated = _restore_settings(trials[0], protocol)
    noise = measure_sighting_sd([_list_sightings(*pair, protocol) for pair in told], stated)
    swung = [_list_sightings(*pair, protocol, template_mm=_TEMPLATE_MM) for pair in told]
    advised_mm = None if noise is None else max(noise.value_mm, TEMPLATE_BIAS_MM)
    backlash = measure_backlash(swung, with_observation_sd(stated, advised_mm or TEMPLATE_BIAS_MM))
    return SightingNoise(
        mean_nis=judged.mean,
        usual_nis=(judged.low, judged.high),
        verdict=judged.verdict,
        stated_observation_sd_mm=stated.estimator.observation_sd_mm,
        observation_sd_mm=None if noise is None else noise.value_mm,
        observation_sd_sd_mm=None if noise is None else noise.sd_mm,
        advised_observation_sd_mm=advised_mm,
        stated_backlash_mm=stated.policy.backlash_mm,
        backlash_mm=None if backlash is None else backlash.value_mm,
        backlash_sd_mm=None if backlash is None else backlash.sd_mm,
    )


def _list_sightings(
    events: _Events, insertion: InsertionTrial, protocol: InsertionProtocol, template_mm: float = 0.0
) -> SeenInsertion:
    """Return the turns of an insertion, and its believed sightings but those within `template_mm` after a turn."""
    steps = {step.frame: step for step in insertion.steps}
    way, swung_mm = list[TipSighting | float](), 0.0
    for event in events.way:
        if isinstance(event, BevelTurn):
            way.append(event.to_rad - event.from_rad)
            swung_mm = event.depth_mm + template_mm
        elif isinstance(event, TipObserved):
            step = steps[event.frame]
            seen_mm = step.tip_mm if step.believed and step.depth_mm >= swung_mm else None
            way.append(TipSighting(step.depth_mm, None if seen_mm is None else np.array((0.0, *seen_mm))))
    return SeenInsertion(begin_steering(_restore_settings(events, protocol)), tuple(way))


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
    kept = np.unique(np.linspace(0, len(path) - 1, min(len(path), _PATH_POINTS)).round().astype(int))
    return tuple(_to_point(point) for point in np.round(path[kept], _DECIMALS)) if len(path) else ()


def _to_point(point: FloatArray) -> Point:
    return float(point[0]), float(point[1])


def _find_widest(intervals: Sequence[Point | None]) -> Point | None:
    """Return the interval that reaches furthest; None if there is none."""
    known = [interval for interval in intervals if interval is not None]
    return max(known, key=lambda interval: interval[1], default=None)


def _combine_reached(reached: Sequence[bool | None]) -> bool | None:
    """Return whether every target was reached: False without an insertion, None if none was missed and one is open."""
    if not reached or False in reached:
        return False
    return None if None in reached else True


def _average(values: Sequence[float]) -> float | None:
    return sum(values) / len(values) if values else None


def _known(values: Iterable[float | None]) -> list[float]:
    return [value for value in values if value is not None]
