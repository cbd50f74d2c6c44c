"""An insertion in the rerun viewer: target, plan and path in the pictures, and curves of the estimate.

Of a run that was measured the estimate is the result's; of one that is being made, what it recorded itself.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
import rerun as rr
from shapely import LineString
from shapely import Point as PlanePoint

from labrig.analysis.calibration import load_plane_map
from labrig.analysis.result import AnalysisResult, Point
from labrig.experiments.insertion.colours import OBSTACLE, PLAN, TAKEN, TARGET
from labrig.experiments.insertion.events import InsertionStart, MarkersSought, PathSought, TipObserved
from labrig.experiments.insertion.recorded_plan import sample_plan
from labrig.experiments.insertion.result import InsertionPlan, InsertionResult, InsertionStep, InsertionTrial
from labrig.record.events import parse_events
from labrig.record.following import RecordLines
from labrig.record.reader import Run
from labrig.report.pictures import circle
from labrig.report.record_drawing import CAMERA, EVENTS, set_time
from labrig.report.view import View, Words
from labrig.steering.moving import Displacement, Displacements
from labrig.steering.problem import Obstacle
from labrig.steering.problem import Point as SpacePoint
from labrig.vision.plane import PlaneMap

_DRAWN = ("obstacles", "target", "plan", "taken", "tip")
_CURVES = (("/error", "Error (mm)"), ("/nis", "NIS of the sightings (2 expected)"))
_ADDED = {
    "error": ("off the plan", "seen - predicted", "estimated - true"),
    "nis": ("NIS", "95 % below"),
    "depth": ("to the target", "to an obstacle"),
    "roll": ("heading",),
}
_PLACES = tuple(rr.new_entity_path([plot, name]) for plot, names in _ADDED.items() for name in names)
# 95 % of the values of a chi-squared distribution with two degrees of freedom lie below.
_NIS_95 = 5.99


@dataclass(frozen=True)
class _Scene:
    """What an insertion aims at, where it is, and whether it moves; lengths in mm."""

    target_mm: SpacePoint
    tolerance_mm: float
    obstacles: tuple[Obstacle, ...]
    moves: bool


@dataclass
class _LiveScene:
    """The scene of an insertion that is being made: what it began with, and where its markers were seen since."""

    start: InsertionStart
    moved: Mapping[int, Displacement] = field(default_factory=dict)

    def find(self) -> _Scene:
        """Return the scene as it is now."""
        start, moved = self.start, Displacements.by_marker(self.start.marker_ids, self.moved)
        return _Scene(
            moved.move_target(start.target_mm),
            start.tolerance_mm,
            moved.move_obstacles(start.obstacles),
            bool(start.marker_ids),
        )

    def take_in(self, event: MarkersSought) -> None:
        """Take in where the markers have moved."""
        self.moved = {
            marker.marker_id: Displacement(marker.displacement_mm, marker.sd_mm) for marker in event.markers
        }


@dataclass(frozen=True)
class _Step:
    """An estimate after a picture; points are (y, z), unknown values None."""

    t_s: float
    depth_mm: float
    tip_mm: Point | None
    estimate_mm: Point
    heading_rad: float
    nis: float | None
    innovation_mm: Point | None
    clearance_mm: float | None = None
    true_mm: Point | None = None


@dataclass
class _Drawing:
    """Draws insertions one after another into a stream."""

    plane: PlaneMap
    live: _LiveScene | None = None
    plan: LineString | None = None
    taken: list[Point] = field(default_factory=list)

    def begin(self, stream: rr.RecordingStream, scene: _Scene, t_s: float) -> None:
        """Draw target and obstacles, and forget the last insertion."""
        self.plan, self.taken = None, []
        set_time(stream, t_s)
        for name in _DRAWN:
            stream.log(f"{CAMERA}/{name}", rr.Clear(recursive=False))
        self._draw_scene(stream, scene)
        _draw_number(stream, "nis", "95 % below", _NIS_95)

    def _draw_scene(self, stream: rr.RecordingStream, scene: _Scene) -> None:
        """Draw target and obstacles."""
        rings = [circle(ball.position_mm[1:], ball.radius_mm, self.plane) for ball in scene.obstacles]
        if rings:
            strips = rr.LineStrips2D(rings, colors=[OBSTACLE], labels=["obstacle"] * len(rings), radii=1.0)
            stream.log(f"{CAMERA}/obstacles", strips)
        target = circle(scene.target_mm[1:], scene.tolerance_mm, self.plane)
        stream.log(
            f"{CAMERA}/target", rr.LineStrips2D([target], colors=[TARGET], labels=["target"], radii=1.5)
        )

    def draw_plan(self, stream: rr.RecordingStream, path_mm: Sequence[Point], t_s: float) -> None:
        """Draw the path that the needle is to take."""
        if len(path_mm) < 2:
            return
        self.plan = LineString(path_mm)
        set_time(stream, t_s)
        self._draw_line(stream, "plan", path_mm, PLAN)

    def draw_step(self, stream: rr.RecordingStream, step: _Step, scene: _Scene | None) -> None:
        """Draw the observed tip, if any, the path taken, what has moved, and the numbers of the estimate."""
        self.taken.append(step.estimate_mm)
        set_time(stream, step.t_s)
        self._draw_line(stream, "taken", self.taken, TAKEN)
        seen = np.empty((0, 2)) if step.tip_mm is None else self.plane.to_px([step.tip_mm])
        stream.log(f"{CAMERA}/tip", rr.Points2D(seen, colors=[TARGET] * len(seen), radii=4.0))
        target_mm = None if scene is None else scene.target_mm[1:]
        if scene is not None and scene.moves:
            self._draw_scene(stream, scene)
        _draw_number(stream, "error", "off the plan", _find_deviation(step.estimate_mm, self.plan))
        _draw_number(stream, "error", "seen - predicted", _find_distance((0.0, 0.0), step.innovation_mm))
        _draw_number(stream, "error", "estimated - true", _find_distance(step.estimate_mm, step.true_mm))
        _draw_number(stream, "nis", "NIS", step.nis)
        _draw_number(stream, "nis", "95 % below", _NIS_95)
        _draw_number(stream, "depth", "to the target", _find_distance(step.estimate_mm, target_mm))
        _draw_number(stream, "depth", "to an obstacle", step.clearance_mm)
        _draw_number(stream, "roll", "heading", math.degrees(step.heading_rad))

    def _draw_line(
        self, stream: rr.RecordingStream, name: str, path_mm: Sequence[Point], colour: tuple[int, int, int]
    ) -> None:
        line = self.plane.to_px(np.array(path_mm))
        stream.log(f"{CAMERA}/{name}", rr.LineStrips2D([line], colors=[colour], radii=1.0))


def make_view(run: Run, result: AnalysisResult[InsertionResult]) -> View:
    """Return the curves of the estimate and the drawings in the pictures, by a result."""
    send = partial(_send, result.content, _Drawing(load_plane_map(run)))
    return View(_CURVES, send, words=_WORDS, added=_PLACES)


def follow(run: Run) -> View:
    """Return the same of a run that is being made, by what it records."""
    drawing = partial(_follow, run, _Drawing(load_plane_map(run)))
    return View(_CURVES, follow=drawing, words=_WORDS, added=_PLACES)


def _send(content: InsertionResult, drawing: _Drawing, stream: rr.RecordingStream, _timeline: str) -> None:
    """Send target, plans, observations and estimates in the order of rig time."""
    for trial in content.insertions:
        drawing.begin(
            stream,
            _Scene(trial.target_mm, trial.tolerance_mm, trial.obstacles, moves=False),
            trial.start_t_s,
        )
        made_in_order: list[InsertionPlan | InsertionStep] = [*trial.plans, *trial.steps]
        for made in sorted(made_in_order, key=lambda made: made.t_s):
            if isinstance(made, InsertionStep):
                drawing.draw_step(stream, _step_of_result(made), _find_scene(trial, made))
            else:
                drawing.draw_plan(stream, made.path_mm, made.t_s)
        if trial.steps and trial.final_frame is not None:
            _send_end(stream, trial)


def _find_scene(trial: InsertionTrial, step: InsertionStep) -> _Scene:
    target_mm, obstacles = trial.locate_places(step.frame)
    return _Scene(target_mm, trial.tolerance_mm, obstacles, bool(trial.marker_ids))


def _follow(
    run: Run, drawing: _Drawing, stream: rr.RecordingStream, _timeline: str, lines: RecordLines
) -> None:
    kinds = (InsertionStart, PathSought, MarkersSought, TipObserved)
    for event in parse_events(run.path, lines.events, kinds):
        match event:
            case InsertionStart():
                drawing.live = _LiveScene(event)
                drawing.begin(stream, drawing.live.find(), event.t_s)
            case PathSought():
                drawing.draw_plan(stream, [(y, z) for _, y, z in sample_plan(event)], event.t_s)
            case MarkersSought() if drawing.live is not None:
                drawing.live.take_in(event)
            case TipObserved():
                scene = None if drawing.live is None else drawing.live.find()
                drawing.draw_step(stream, _step_of_event(event), scene)


def _step_of_result(step: InsertionStep) -> _Step:
    return _Step(
        t_s=step.t_s,
        depth_mm=step.depth_mm,
        tip_mm=step.tip_mm,
        estimate_mm=step.estimate_mm,
        heading_rad=step.heading_rad,
        nis=step.nis,
        innovation_mm=step.innovation_mm,
        clearance_mm=step.clearance_mm,
        true_mm=step.true_mm,
    )


def _step_of_event(event: TipObserved) -> _Step:
    estimate = event.estimate
    return _Step(
        t_s=event.t_s,
        depth_mm=event.depth_mm,
        tip_mm=None if event.tip_mm is None else event.tip_mm[1:],
        estimate_mm=estimate.position_mm[1:],
        heading_rad=estimate.heading_rad,
        nis=event.nis,
        innovation_mm=None if event.innovation_mm is None else event.innovation_mm[1:],
    )


def _send_end(stream: rr.RecordingStream, trial: InsertionTrial) -> None:
    error = (
        "not measured" if trial.target_error_mm is None else f"{trial.target_error_mm:.2f} mm from the target"
    )
    stream.log(EVENTS, rr.TextLog(f"insertion {trial.trial + 1}: {trial.outcome}, {error}", level="INFO"))


def _find_deviation(point_mm: Point, plan: LineString | None) -> float | None:
    """Return the distance of a point from a plan; None if it has not come to where the plan begins."""
    point = PlanePoint(point_mm)
    return None if plan is None or plan.project(point) == 0.0 else plan.distance(point)


def _find_distance(point_mm: Point, other_mm: Sequence[float] | None) -> float | None:
    return None if other_mm is None else math.dist(point_mm, other_mm)


def _draw_number(stream: rr.RecordingStream, plot: str, name: str, value: float | None) -> None:
    """Add a point to a curve; none if the value is unknown."""
    if value is not None:
        stream.log(rr.new_entity_path([plot, name]), rr.Scalars(value))


def _describe_plan(event: Mapping[str, Any]) -> str:
    if not event["found"]:
        return f"no path from {event['depth_mm']:.1f} mm on: {event['reason']}"
    arcs = len(event["arcs"])
    return (
        f"path planned at {event['depth_mm']:.1f} mm ({event['because']}): "
        f"{arcs} {'arc' if arcs == 1 else 'arcs'}, {event['length_mm']:.0f} mm"
    )


def _describe_sighting(event: Mapping[str, Any]) -> str:
    if not event["accepted"]:
        return f"tip not seen at {event['depth_mm']:.1f} mm: {event['reason']}"
    trust = "" if event["believed"] else ", not believed"
    return f"tip seen at {event['depth_mm']:.1f} mm{trust}"


def _describe_markers(event: Mapping[str, Any]) -> str:
    return "; ".join(
        f"marker {marker['marker_id']} has moved by {math.hypot(*marker['displacement_mm']):.2f} mm"
        + ("" if marker["believed"] else f", not seen: {marker['reason'] or 'it jumped'}")
        for marker in event["markers"]
    )


def _describe_turn(event: Mapping[str, Any]) -> str:
    turn_deg = math.degrees(event["to_rad"] - event["from_rad"])
    return f"bevel turns by {turn_deg:+.0f}° at {event['depth_mm']:.1f} mm"


def _describe_sheath(event: Mapping[str, Any]) -> str:
    if not event["accepted"]:
        return f"sheath is not where it should be: {event['reason']}"
    return f"sheath found, {event['disagreement_mm']:.2f} mm from where the encoder puts it"


_WORDS: Mapping[str, Words] = {
    "flip": _describe_turn,
    "plan": _describe_plan,
    "observation": _describe_sighting,
    "origin": _describe_sheath,
    "hold": lambda event: f"needle holds still: {event['detail'] or event['stop']}",
    "markers": _describe_markers,
}
