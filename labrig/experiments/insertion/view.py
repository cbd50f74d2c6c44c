"""An insertion in the rerun viewer: target, plan and path in the pictures, and curves of the estimate, as recorded."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np
import rerun as rr
from numpy.typing import NDArray
from shapely import LineString
from shapely import Point as PlanePoint

from labrig.analysis.pictures import load_plane_map
from labrig.analysis.result import AnalysisResult, Point
from labrig.experiments.insertion.colours import OBSTACLE, PLAN, TAKEN, TARGET
from labrig.experiments.insertion.events import (
    InsertionStart,
    MarkersSought,
    PathSought,
    TipObserved,
)
from labrig.experiments.insertion.recorded_plan import sample_plan
from labrig.experiments.insertion.result import InsertionResult, InsertionTrial
from labrig.record.events import Event, parse_events
from labrig.record.following import RecordLines
from labrig.record.reader import Run
from labrig.report.pictures import circle
from labrig.report.rerun_view import CAMERA, EVENTS, set_time
from labrig.report.view import View
from labrig.steering.moving import Displacement, Displacements
from labrig.steering.problem import Obstacle
from labrig.steering.problem import Point as SpacePoint
from labrig.vision.plane import PlaneMap

_DRAWN = ("obstacles", "target", "plan", "taken", "tip")
_CURVES = (("/error", "Error (mm)"), ("/nis", "NIS of the sightings (2 expected)"))
_ADDED = {
    "error": ("off the plan", "seen - predicted"),
    "nis": ("NIS", "95 % below"),
    "depth": ("to the target", "to an obstacle"),
    "roll": ("heading",),
}
_KINDS = (InsertionStart, PathSought, MarkersSought, TipObserved)
_PLACES = tuple(rr.new_entity_path([plot, name]) for plot, names in _ADDED.items() for name in names)
# 95 % of the values of a chi-squared distribution with two degrees of freedom lie below.
_NIS_95 = 5.99


@dataclass
class _Drawing:
    """Draws insertions one after another into a stream."""

    plane: PlaneMap
    start: InsertionStart | None = None
    moved: Mapping[int, Displacement] = field(default_factory=dict)
    plan: LineString | None = None
    taken: list[Point] = field(default_factory=list)

    def draw(self, stream: rr.RecordingStream, event: Event) -> None:
        """Draw what an event adds."""
        match event:
            case InsertionStart():
                self._begin(stream, event)
            case PathSought():
                self.draw_plan(stream, sample_plan(event), event.t_s)
            case MarkersSought():
                self.moved = {
                    marker.marker_id: Displacement(marker.displacement_mm, marker.sd_mm)
                    for marker in event.markers
                }
            case TipObserved():
                self._draw_step(stream, event)

    def _begin(self, stream: rr.RecordingStream, start: InsertionStart) -> None:
        """Draw target and obstacles, and forget the last insertion."""
        self.start, self.moved, self.plan, self.taken = start, {}, None, []
        set_time(stream, start.t_s)
        for name in _DRAWN:
            stream.log(f"{CAMERA}/{name}", rr.Clear(recursive=False))
        self._draw_scene(stream)
        _draw_number(stream, "nis", "95 % below", _NIS_95)

    def _locate(self) -> tuple[SpacePoint, tuple[Obstacle, ...]]:
        """Return where target and obstacles are now."""
        assert self.start is not None
        moved = Displacements.by_marker(self.start.marker_ids, self.moved)
        return moved.move_target(self.start.target_mm), moved.move_obstacles(self.start.obstacles)

    def _draw_scene(self, stream: rr.RecordingStream) -> None:
        """Draw target and obstacles."""
        assert self.start is not None
        target_mm, obstacles = self._locate()
        rings = [circle(ball.position_mm[1:], ball.radius_mm, self.plane) for ball in obstacles]
        if rings:
            strips = rr.LineStrips2D(rings, colors=[OBSTACLE], labels=["obstacle"] * len(rings), radii=1.0)
            stream.log(f"{CAMERA}/obstacles", strips)
        target = circle(target_mm[1:], self.start.tolerance_mm, self.plane)
        stream.log(
            f"{CAMERA}/target", rr.LineStrips2D([target], colors=[TARGET], labels=["target"], radii=1.5)
        )

    def draw_plan(self, stream: rr.RecordingStream, path_mm: NDArray[np.float64], t_s: float) -> None:
        """Draw the path that the needle is to take."""
        if len(path_mm) < 2:
            return
        self.plan = LineString(path_mm)
        set_time(stream, t_s)
        self._draw_line(stream, "plan", path_mm, PLAN)

    def _draw_step(self, stream: rr.RecordingStream, event: TipObserved) -> None:
        """Draw the observed tip, if any, the path taken, what has moved, and the numbers of the estimate."""
        estimate_mm = event.estimate.position_mm[1:]
        self.taken.append(estimate_mm)
        set_time(stream, event.t_s)
        self._draw_line(stream, "taken", self.taken, TAKEN)
        seen = np.empty((0, 2)) if event.tip_mm is None else self.plane.to_px([event.tip_mm[1:]])
        stream.log(f"{CAMERA}/tip", rr.Points2D(seen, colors=[TARGET] * len(seen), radii=4.0))
        if self.start is not None:
            if self.start.marker_ids:
                self._draw_scene(stream)
            target_mm, obstacles = self._locate()
            _draw_number(stream, "depth", "to the target", math.dist(estimate_mm, target_mm[1:]))
            gaps_mm = [math.dist(estimate_mm, ball.position_mm[1:]) - ball.radius_mm for ball in obstacles]
            _draw_number(stream, "depth", "to an obstacle", min(gaps_mm, default=None))
        _draw_number(stream, "error", "off the plan", _find_deviation(estimate_mm, self.plan))
        if event.innovation_mm is not None:
            _draw_number(stream, "error", "seen - predicted", math.hypot(*event.innovation_mm[1:]))
        _draw_number(stream, "nis", "NIS", event.nis)
        _draw_number(stream, "nis", "95 % below", _NIS_95)
        _draw_number(stream, "roll", "heading", math.degrees(event.estimate.heading_rad))

    def _draw_line(
        self,
        stream: rr.RecordingStream,
        name: str,
        path_mm: Sequence[Point] | NDArray[np.float64],
        colour: tuple[int, int, int],
    ) -> None:
        line = self.plane.to_px(np.array(path_mm))
        stream.log(f"{CAMERA}/{name}", rr.LineStrips2D([line], colors=[colour], radii=1.0))


def make_view(run: Run, result: AnalysisResult[InsertionResult]) -> View:
    """Return the curves of the estimate and the drawings in the pictures, and how each insertion ended."""
    return View(_CURVES, partial(_send, run, result.content), words=_WORDS, added=_PLACES)


def follow(run: Run) -> View:
    """Return the same of a run that is being made."""
    drawing = _Drawing(load_plane_map(run))
    return View(_CURVES, follow=partial(_follow, run, drawing), words=_WORDS, added=_PLACES)


def _send(run: Run, content: InsertionResult, stream: rr.RecordingStream, _timeline: str) -> None:
    drawing = _Drawing(load_plane_map(run))
    for event in run.read_events(*_KINDS):
        drawing.draw(stream, event)
    for trial in content.insertions:
        if trial.final_frame is not None:
            set_time(stream, run.frame_line(trial.final_frame).t_s)
            _send_end(stream, trial)


def _follow(
    run: Run, drawing: _Drawing, stream: rr.RecordingStream, _timeline: str, lines: RecordLines
) -> None:
    for event in parse_events(run.path, lines.events, _KINDS):
        drawing.draw(stream, event)


def _send_end(stream: rr.RecordingStream, trial: InsertionTrial) -> None:
    error = (
        "not measured" if trial.target_error_mm is None else f"{trial.target_error_mm:.2f} mm from the target"
    )
    stream.log(EVENTS, rr.TextLog(f"insertion {trial.trial + 1}: {trial.outcome}, {error}", level="INFO"))


def _find_deviation(point_mm: Point, plan: LineString | None) -> float | None:
    """Return the distance of a point from a plan; None if it has not come to where the plan begins."""
    point = PlanePoint(point_mm)
    return None if plan is None or plan.project(point) == 0.0 else plan.distance(point)


def _draw_number(stream: rr.RecordingStream, plot: str, name: str, value: float | None) -> None:
    """Add a point to a curve; none if the value is unknown."""
    if value is not None:
        stream.log(rr.new_entity_path([plot, name]), rr.Scalars(value))


_WORDS = {
    "flip": "bevel turns by {{ '%+.0f' % (to_rad - from_rad) | degrees }}° at {{ '%.1f' % depth_mm }} mm",
    "plan": "{% if found %}path planned at {{ '%.1f' % depth_mm }} mm ({{ because }}): {{ arcs | count }} "
    "{{ 'arc' if arcs | count == 1 else 'arcs' }}, {{ '%.0f' % length_mm }} mm{% else %}no path from "
    "{{ '%.1f' % depth_mm }} mm on: {{ reason }}{% endif %}",
    "observation": "tip {% if accepted %}seen at {{ '%.1f' % depth_mm }} mm{{ '' if believed else ', not believed' }}"
    "{% else %}not seen at {{ '%.1f' % depth_mm }} mm: {{ reason }}{% endif %}",
    "origin": "sheath {% if accepted %}found, {{ '%.2f' % disagreement_mm }} mm from where the encoder puts it"
    "{% else %}is not where it should be: {{ reason }}{% endif %}",
    "hold": "needle holds still: {{ detail or stop }}",
    "markers": "{% for marker in markers %}marker {{ marker.marker_id }} has moved by "
    "{{ '%.2f' % marker.displacement_mm | norm }} mm"
    "{{ '' if marker.believed else ', not seen: ' ~ (marker.reason or 'it jumped') }}"
    "{{ '' if loop.last else '; ' }}{% endfor %}",
}
