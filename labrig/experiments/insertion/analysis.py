"""Measure how close to their targets the insertions of a run ended, and estimate the tip along the way again.

Errors are measured in the final pictures, at the end of the shaft. The estimator then runs again over the recorded
pictures: the tip is found in each, and its pose estimated with the recorded turns. With the settings of the protocol
the estimates are those of the run; other settings (`labrig reanalyze --set estimator.observation_sd_mm=0.1`) say what
would have been estimated of the path that the needle took.
"""

import math
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labrig.analysis.experiment import AnalysisRequest
from labrig.analysis.origin import find_origins
from labrig.analysis.pictures import list_not_in_interval, load_plane_map
from labrig.analysis.result import Findings, Sentinel, TrialOrigin
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
    PathSought,
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
from labrig.steering.policy import TipSighting
from labrig.steering.problem import PlanProblem
from labrig.steering.sighting_noise import SeenInsertion, measure_noise
from labrig.steering.state import begin_steering, take_in_sighting, turn_bevel
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
    made, insertions, seen = _read_insertions(source), list[InsertionTrial](), list[SeenInsertion]()
    for number, insertion in enumerate(made, start=1):
        insertion.follow()
        insertions.append(insertion.analyze())
        seen.append(SeenInsertion(insertion.begun, tuple(insertion.seen)))
        if request.progress is not None:
            request.progress(number, len(made))
    steps = [step for trial in insertions for step in trial.steps if step.believed]
    outcomes = {trial.reached for trial in insertions}
    scenes = [line for line in run.frame_lines if line.role == InsertionRole.SCENE]
    result = InsertionResult(
        **request.stamp.list_members(
            {"estimator": protocol.estimator.model_dump(), "planner": protocol.planner.model_dump()}
        ),
        made=len(insertions),
        arrived=sum(trial.reached is True for trial in insertions),
        causes=dict(Counter(trial.stop for trial in insertions if not trial.reached)),
        # A target that was missed counts before one of which it is not known; without an insertion none was reached.
        reached=next((worst for worst in (False, None) if worst in outcomes), bool(outcomes)),
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
            seen[:_MOST_NOISE_INSERTIONS], _known(step.nis for step in steps), made[0].planned
        )
        if made
        else None,
        not_in_interval=list_not_in_interval(plane, (trial.target_error_budget_mm for trial in insertions)),
    )
    return Findings(result)


@dataclass(eq=False)
class _Insertion:
    """A recorded insertion: its events, and what is known of it after those that were followed again."""

    source: _Source
    start: InsertionStart
    stop: InsertionStop
    sheath: TrialOrigin | None
    way: tuple[InsertionEvent, ...]
    true: TrueInsertion

    def __post_init__(self) -> None:
        start, protocol = self.start, self.source.protocol
        self.aim = Aim(start.target_mm, start.obstacles)
        try:
            asked = make_insertion_settings(protocol, start.target_mm, start.obstacles)
        except InputError:  # an insertion that ended before it was planned: its target lies in an obstacle
            asked = make_insertion_settings(protocol, start.target_mm, ())
        self.planned = self.settings = start_at(asked, self.sheath)
        self.markers = FollowedMarkers.of(protocol, self.source.view.plane)
        self.begun = self.state = begin_steering(self.settings)
        self.steps, self.seen = list[InsertionStep](), list[TipSighting | float]()
        frames = (line for line in self.source.run.frame_lines if line.trial == start.trial)
        self.inserted_mm = max((frame.insertion_mm or 0.0 for frame in frames), default=0.0)

    def follow(self) -> None:
        """Find tip and markers again in each picture, and estimate the tip's pose with the recorded turns."""
        for event in self.way:
            match event:
                case MarkersSought():
                    self._follow_markers(event)
                case BevelTurn():
                    self.seen.append(event.to_rad - event.from_rad)
                    self.state = turn_bevel(self.state, event.to_rad - event.from_rad, self.settings)
                case TipObserved():
                    self._observe(event)

    def _follow_markers(self, event: MarkersSought) -> None:
        if self.markers is not None:
            corners = (
                (seen, None if seen.corners_px is None else np.array(seen.corners_px))
                for seen in event.markers
            )
            found = [MarkerFix(seen.marker_id, px, seen.reason) for seen, px in corners]
            self.markers = self.markers.take(found, event.trial, event.frame, event.depth_mm)
            self.settings, _ = self.markers.place(self.settings, self.aim)

    def _observe(self, event: TipObserved) -> None:
        predicted = self.state.predict(event.depth_mm, self.settings)
        fix, seen_mm = self._find_tip(event, predicted)
        self.state = take_in_sighting(self.state, TipSighting(event.depth_mm, seen_mm), self.settings)
        tip = self.state.tip
        self.seen.append(TipSighting(event.depth_mm, seen_mm if tip.accepted else None))
        self.steps.append(
            InsertionStep(
                frame=event.frame,
                t_s=event.t_s,
                **describe_sighting(fix, seen_mm, predicted[:3, 3], self.state),
                clearance_mm=_find_clearance_mm(tip.position_mm, self.settings.problem),
                **_find_truth(self.true.path, event.depth_mm, self.inserted_mm),
            )
        )

    def _find_tip(self, event: TipObserved, predicted: FloatArray) -> tuple[TipFix, FloatArray | None]:
        """Find the tip in a recorded picture, as a live insertion does."""
        source = self.source
        try:
            image = source.run.pictures.places[event.frame].read()
            found = find_tip(source.view, image, predicted, self.state.tip, event.bevel_rad)
        except (PictureError, RecordError) as error:
            return TipFix(accepted=False, reason=source.explain(error)), None
        return found.fix, found.position_mm

    def analyze(self) -> InsertionTrial:
        """Return how the insertion ended."""
        start, stop, steps, markers = self.start, self.stop, self.steps, self.markers
        target_mm = self.settings.problem.target_mm[1:]
        end, unmeasured = self._measure_end()
        bounds = self._judge_end(end)
        budget = None if end is None or bounds is None else _find_budget(end, bounds, self.source)
        ending = self._decide_ending(bounds)
        nis = _known(step.nis for step in steps if step.believed)
        return InsertionTrial(
            **start.model_dump(include={"trial", "target_mm", "marker_ids"}),
            start_t_s=start.t_s,
            obstacles=start.obstacles,
            outcome=ending.outcome,
            stop=ending.stop,
            cause=ending.cause,
            reached=ending.reached,
            tolerance_mm=self.settings.problem.tolerance_mm,
            final_frame=stop.final_frame,
            replans=stop.replans,
            length_mm=None if stop.exit_status == INCOMPLETE else stop.depth_mm,
            tip_mm=None if end is None else end.tip_mm,
            shaft_mm=() if end is None else (*_thin_path(end.centre_line_mm)[:-1], end.tip_mm),
            target_error_mm=None if end is None or bounds is None else bounds.in_plane_mm,
            sigma_target_error_mm=None if budget is None else budget.total,
            target_error_budget_mm=budget,
            unmeasured=unmeasured,
            **({} if bounds is None else bounds.describe()),
            template_error_mm=math.dist(steps[-1].estimate_mm, target_mm) if steps else None,
            **{name: value for name, value in self.true if name.startswith("true_")},
            refused=next((event.cause for event in self.way[::-1] if isinstance(event, PathSought)), None),
            true_path_mm=_thin_path(self.true.path),
            true_target_mm=self.true.target_mm,
            missed_sightings=sum(not step.believed for step in steps),
            mean_nis=float(np.mean(nis)) if nis else None,
            steps=tuple(steps),
            as_recorded=self._agrees(),
            marker_steps=() if markers is None else tuple(_list_marker_steps(markers)),
        )

    def _agrees(self) -> bool:
        """Return whether every estimate is the recorded one, as closely as two processors agree."""
        recorded = (event for event in self.way if isinstance(event, TipObserved))
        return all(
            math.dist(step.estimate_mm, before.estimate_mm) <= SHARE_OF_SD * step.position_sd_mm
            for step, before in zip(self.steps, recorded, strict=True)
        )

    def _measure_end(self) -> tuple[ShaftTip | None, str | None]:
        """Measure the shaft in the final picture; without a measurement, return the reason."""
        frame, source, protocol = self.stop.final_frame, self.source, self.source.protocol
        if frame is None or source.bumped is not None:
            return None, source.bumped if frame is not None else "there is no final picture"
        try:
            shaft = measure_shaft_tip(
                source.run.pictures.places[frame].read(),
                source.view.plane,
                protocol.needle.diameter_mm,
                protocol.sheath.diameter_mm,
                mask=source.view.mask,
            )
        except (MeasurementRefusedError, PictureError, RecordError) as error:
            return None, source.explain(error)
        return shaft, None

    def _judge_end(self, shaft: ShaftTip | None) -> TargetErrorBounds | None:
        """Return the distance in space from the target; None if nothing was seen, or the camera was bumped."""
        start, stop, source, tip = self.start, self.stop, self.source, self.state.tip
        if stop.exit_status == INCOMPLETE or source.bumped is not None:
            return None
        turns = [event for event in self.way if isinstance(event, BevelTurn)]
        backlash_mm = self.settings.policy.backlash_mm
        estimate = EstimatedEnd(tip.position_mm[1:], tip.position_sd_mm, self.state.seen)
        return judge_end(
            trace_path(turns, start.roll_zero_rad, stop.depth_mm, stop.centred, backlash_mm),
            self.settings,
            make_out_of_plane(source.protocol, start.roll_zero_sd_rad, start.torsion),
            source.view.plane,
            find_target_sd_mm(source.protocol, self.markers),
            shaft=shaft,
            estimate=estimate if self.steps else None,
            drift=source.drift,
        )

    def _decide_ending(self, bounds: TargetErrorBounds | None) -> Ending:
        """Return how it ended: as the live one was decided, unless the camera was bumped."""
        stop, held = self.stop, next((event for event in self.way if isinstance(event, NeedleHeld)), None)
        if held is None or stop.exit_status == INCOMPLETE:
            return Ending(stop.outcome, str(stop.stop), stop.cause)
        doubt = None if self.markers is None else self.markers.doubt
        if self.source.bumped is not None:
            doubt = Ending("unknown", "camera_bumped", self.source.bumped)
        return decide_ending(str(held.stop), held.detail, bounds, self.settings.problem.tolerance_mm, doubt)


def _read_insertions(source: _Source) -> list[_Insertion]:
    """Return each recorded insertion that was neither made again nor left out by a person."""
    run = source.run
    sheaths = {event.origin.trial: event.origin for event in run.read_events(InsertionSheath)}
    way = run.read_events(BevelTurn, TipObserved, MarkersSought, NeedleHeld, PathSought)
    true = run.read_truth(TrueInsertion)
    return [
        _Insertion(
            source,
            trial.start,
            trial.stop or InsertionStop(trial=trial.start.trial, **_UNRECORDED),
            sheaths.get(trial.start.trial),
            tuple(event for event in way if event.trial == trial.start.trial),
            true.get(trial.start.trial, TrueInsertion(trial=trial.start.trial)),
        )
        for trial in run.read_trials(InsertionStart, InsertionStop)
        if not trial.left_out and trial.exit_status != INTERRUPTED
    ]


def _list_marker_steps(markers: FollowedMarkers) -> Iterator[MarkerStep]:
    for event in markers.sought:
        for seen in event.markers:
            fields = seen.model_dump(exclude={"corners_px"})
            yield MarkerStep(frame=event.frame, depth_mm=event.depth_mm, **fields)


def _find_truth(path_mm: FloatArray, depth_mm: float, inserted_mm: float) -> dict[str, Any]:
    """Return the true place and heading at a depth on a path (N, 3) that took so much needle; None without a path.

    Of what is pushed in, the tip stays behind by the slip.
    """
    if len(path_mm) < 2:
        return {"true_mm": None, "true_heading_rad": None}
    rises_mm = np.diff(path_mm, axis=0)
    arc_mm = np.concatenate(([0.0], np.cumsum(np.linalg.norm(rises_mm, axis=1))))
    at_mm = depth_mm * arc_mm[-1] / inserted_mm
    at = min(max(int(np.searchsorted(arc_mm, at_mm)), 1), len(rises_mm)) - 1
    place_mm = tuple(float(np.interp(at_mm, arc_mm, along)) for along in path_mm.T[1:])
    return {"true_mm": place_mm, "true_heading_rad": float(np.arctan2(*rises_mm[at, 1:]))}


def _find_clearance_mm(position_mm: FloatArray, problem: PlanProblem) -> float | None:
    """Return the distance from the needle's surface at the tip to the surface of the nearest obstacle."""
    apart = [
        math.dist(position_mm, obstacle.position_mm) - obstacle.radius_mm for obstacle in problem.obstacles
    ]
    return min(apart) - problem.diameter_mm / 2 if apart else None


def _find_budget(end: ShaftTip, bounds: TargetErrorBounds, source: _Source) -> ErrorBudget:
    """Return the error budget of the distance from the target to the end of the shaft.

    The drift between the grid pictures scales with the distance from the origin, and is a part of the plane's. The
    roll's part is what the depth that is not known makes of it.
    """
    towards = bounds.off_mm / max(bounds.in_plane_mm, 1e-9)
    errors = replace(bounds.errors, roll_shift_mm=bounds.ray_sd_mm if bounds.ray_sd_mm.any() else None)
    budget = budget_place(source.view.plane, end.tip_px, errors, towards)
    return budget.with_drift(source.drift * math.hypot(*end.tip_mm))


def _thin_path(path: FloatArray) -> tuple[Any, ...]:
    """Return a path (N, 2) or (N, 3) thinned for drawing, with both ends."""
    kept = np.linspace(0, len(path) - 1, min(len(path), _PATH_POINTS)).round().astype(int)
    return tuple(map(tuple, np.round(path[kept], _DECIMALS).tolist()))


def _known(values: Iterable[float | None]) -> list[float]:
    return [value for value in values if value is not None]
