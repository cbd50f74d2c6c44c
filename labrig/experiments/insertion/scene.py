"""What stands in the pictures of an insertion, as lines over them, which page, film and viewer draw.

It is folded from the recorded events, so it shows what the insertion was steered by.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from labrig.analysis.pictures import load_plane_map
from labrig.analysis.result import Point
from labrig.experiments.insertion.aim import Aim
from labrig.experiments.insertion.events import (
    InsertionStart,
    MarkersSought,
    PathSought,
    SeenMarker,
    TipObserved,
)
from labrig.experiments.insertion.markers import locate_places
from labrig.experiments.insertion.result import InsertionResult, InsertionTrial
from labrig.record.events import Event
from labrig.record.reader import Run
from labrig.report.film_pictures import Colour, Film, FilmPicture, Stroke
from labrig.report.pictures import circle
from labrig.steering.planner import sample_path
from labrig.steering.problem import PlanProblem
from labrig.vision.plane import PlaneMap

FloatArray = NDArray[np.float64]

KINDS = (InsertionStart, PathSought, MarkersSought, TipObserved)
"""The events that a scene is folded from."""

# Red, green and blue by Okabe and Ito, as in the figures.
COLOURS: Mapping[str, Colour] = {
    "obstacle": (213, 94, 0),
    "target": (0, 158, 115),
    "plan": (255, 166, 0),
    "taken": (86, 180, 233),
    "seen": (255, 255, 255),
}
_TIP_MM = 1.0


def sample_plan(event: PathSought) -> FloatArray:
    """Return the points (N, 2) of a recorded plan, (y, z) [mm]; none if there was no path."""
    bent = [arc for arc in event.plan.arcs if arc.angle_rad > 0.0]
    if not bent:
        return np.empty((0, 2))
    radius_mm = bent[0].length_mm / bent[0].angle_rad
    # Where the arcs lie depends on their start and radius alone.
    start = np.eye(4)
    start[:3, :3], start[:3, 3] = event.start_rotation, event.start_mm
    problem = PlanProblem(target_mm=event.start_mm, start=start, radius_mm=radius_mm)
    return sample_path(problem, event.plan)[:, 1:]


def read_scenes(run: Run) -> Mapping[int, Sequence[Event]]:
    """Return the events of each trial that its scene is folded from, in the order of time."""
    events: dict[int, list[Event]] = {}
    for event in run.read_events(*KINDS):
        assert isinstance(event, KINDS)
        events.setdefault(event.trial, []).append(event)
    return events


@dataclass
class Scene:
    """Target and obstacles where they are, the last plan and those before, and the path taken, (y, z) [mm]."""

    plane: PlaneMap
    start: InsertionStart | None = None
    plan_mm: FloatArray = field(default_factory=lambda: np.empty((0, 2)))
    taken_mm: list[Point] = field(default_factory=list)
    former: list[Stroke] = field(default_factory=list)
    last: TipObserved | None = None
    markers: Sequence[SeenMarker] = ()

    def take(self, event: Event) -> None:
        """Take in what an event adds; a new insertion begins anew."""
        match event:
            case InsertionStart():
                self.__init__(self.plane, event)  # type: ignore[misc]
            case PathSought() if event.plan.found:
                self.former += self.draw_line("former", self.plan_mm)
                self.plan_mm = sample_plan(event)
            case MarkersSought():
                self.markers = event.markers
            case TipObserved():
                self.last = event
                self.taken_mm.append(event.estimate_mm)

    def locate(self) -> Aim:
        """Return where target and obstacles are now."""
        assert self.start is not None
        aim = Aim(self.start.target_mm, self.start.obstacles)
        return locate_places(aim, self.start.marker_ids, self.markers)

    def draw_places(self) -> Iterator[Stroke]:
        """Yield the obstacles, and the target with its tolerance."""
        assert self.start is not None
        aim = self.locate()
        target_mm = aim.target_mm[1:]
        for ball in aim.obstacles:
            yield self.draw_ring("obstacle", ball.position_mm[1:], ball.radius_mm)
        yield self.draw_ring("target", target_mm, self.start.tolerance_mm)
        yield from self._draw_cross("target", target_mm)

    def draw_ways(self) -> Iterator[Stroke]:
        """Yield the plan and the path taken."""
        yield from self.draw_line("plan", self.plan_mm)
        yield from self.draw_line("taken", self.taken_mm)

    def draw_tip(self) -> Iterator[Stroke]:
        """Yield a ring around the estimated tip, and a cross where the tip was seen and believed."""
        if self.last is not None:
            yield self.draw_ring("taken", self.last.estimate_mm, _TIP_MM)
            if self.last.tip_mm is not None and self.last.believed:
                yield from self._draw_cross("seen", self.last.tip_mm)

    def draw_line(self, name: str, points_mm: Sequence[Point] | FloatArray) -> Iterator[Stroke]:
        """Yield a line through points (N, 2) of the plane, if there is one."""
        if len(points_mm) > 1:
            yield _make_stroke(name, self.plane.to_px(np.array(points_mm)))

    def draw_ring(self, name: str, place_mm: Sequence[float], radius_mm: float) -> Stroke:
        """Return a circle of the plane."""
        return _make_stroke(name, circle(place_mm, radius_mm, self.plane))

    def _draw_cross(self, name: str, place_mm: Sequence[float]) -> Iterator[Stroke]:
        for along in _TIP_MM * np.eye(2):
            ends_mm = np.array((place_mm - along, place_mm + along))
            yield _make_stroke(name, self.plane.to_px(ends_mm))

    @property
    def left_mm(self) -> float | None:
        """The distance in the plane from the estimated tip to the target; None before the first sighting."""
        return None if self.last is None else math.dist(self.last.estimate_mm, self.locate().target_mm[1:])


def make_films(run: Run, content: InsertionResult) -> tuple[Film, ...]:
    """Return a film of each insertion that was steered by pictures."""
    events, plane = read_scenes(run), load_plane_map(run)
    return tuple(
        Film(f"insertion-{trial.trial + 1}", tuple(_list_pictures(trial, events[trial.trial], plane)))
        for trial in content.insertions
        if trial.steps
    )


def _list_pictures(trial: InsertionTrial, events: Sequence[Event], plane: PlaneMap) -> Iterator[FilmPicture]:
    scene = Scene(plane)
    for event in events:
        scene.take(event)
        if isinstance(event, TipObserved):
            strokes = *scene.draw_places(), *scene.draw_ways(), *scene.draw_tip()
            at = f"{event.depth_mm:.1f} mm inserted, {event.t_s - trial.start_t_s:.0f} s"
            yield FilmPicture(event.frame, strokes, f"{at}, {scene.left_mm:.1f} mm to the target")
    if trial.final_frame is not None:
        end = *scene.draw_places(), *scene.draw_line("taken", trial.shaft_mm)
        off_mm = trial.target_error_mm
        error = "not measured" if off_mm is None else f"{off_mm:.2f} mm from the target in the plane"
        yield FilmPicture(trial.final_frame, end, f"{trial.outcome}: {error}")


def _make_stroke(name: str, px: FloatArray) -> Stroke:
    return Stroke(px, COLOURS.get(name, (255, 255, 255)), 1 if name == "seen" else 2, name)
