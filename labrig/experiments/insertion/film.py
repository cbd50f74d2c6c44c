"""The film of an insertion: plan, estimate, target and obstacles in every picture that it was steered by."""

import math
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from labrig.analysis.result import Point
from labrig.experiments.insertion.colours import OBSTACLE, PLAN, TAKEN, TARGET
from labrig.experiments.insertion.events import PathSought
from labrig.experiments.insertion.recorded_plan import read_plans, sample_plan
from labrig.experiments.insertion.result import InsertionResult, InsertionStep, InsertionTrial
from labrig.record.reader import Run
from labrig.report.film_pictures import Colour, Film, FilmPicture, Stroke
from labrig.report.pictures import circle
from labrig.vision.plane import PlaneMap

FloatArray = NDArray[np.float64]

_TIP_RADIUS_MM = 1.0
_SEEN: Colour = (255, 255, 255)


def make_films(run: Run, content: InsertionResult, plane: PlaneMap) -> tuple[Film, ...]:
    """Return a film of each insertion that was steered by pictures."""
    plans = read_plans(run)
    return tuple(
        Film(f"insertion-{trial.trial + 1}", tuple(_list_pictures(trial, plans.get(trial.trial, ()), plane)))
        for trial in content.insertions
        if trial.steps
    )


def _list_pictures(
    trial: InsertionTrial, plans: Sequence[PathSought], plane: PlaneMap
) -> Iterator[FilmPicture]:
    taken: list[Point] = []
    for step in trial.steps:
        taken.append(step.estimate_mm)
        strokes = (
            *_draw_scene(trial, step.frame, plane),
            *_draw_line(_find_plan(plans, step.t_s), PLAN, "plan", plane),
            *_draw_line(taken, TAKEN, "estimate", plane),
            *_draw_tip(step, plane),
        )
        yield FilmPicture(step.frame, strokes, _write_caption(trial, step))
    if trial.final_frame is not None:
        end = (
            *_draw_scene(trial, trial.final_frame, plane),
            *_draw_line(trial.shaft_mm, TAKEN, "shaft", plane),
        )
        yield FilmPicture(trial.final_frame, end, _write_end(trial))


def _find_plan(plans: Sequence[PathSought], t_s: float) -> Sequence[Point] | FloatArray:
    """Return the path that was followed at a rig time [s]; empty before the first."""
    followed = next((plan for plan in reversed(plans) if plan.found and plan.t_s <= t_s), None)
    return () if followed is None else sample_plan(followed)


def _draw_scene(trial: InsertionTrial, frame: int, plane: PlaneMap) -> Iterator[Stroke]:
    target_mm, obstacles = trial.locate_places(frame)
    for ball in obstacles:
        yield Stroke(circle(ball.position_mm[1:], ball.radius_mm, plane), OBSTACLE, name="obstacle")
    yield Stroke(circle(target_mm[1:], trial.tolerance_mm, plane), TARGET, name="target")


def _draw_tip(step: InsertionStep, plane: PlaneMap) -> Iterator[Stroke]:
    """Draw a ring around the estimated tip, and a cross where the tip was seen and believed."""
    yield Stroke(circle(step.estimate_mm, _TIP_RADIUS_MM, plane), TAKEN)
    if step.tip_mm is not None and step.believed:
        for along in _TIP_RADIUS_MM * np.eye(2):
            yield Stroke(plane.to_px(np.array((step.tip_mm - along, step.tip_mm + along))), _SEEN, 1, "seen")


def _draw_line(
    points_mm: Sequence[Point] | FloatArray, colour: Colour, name: str, plane: PlaneMap
) -> Iterator[Stroke]:
    if len(points_mm) > 1:
        yield Stroke(plane.to_px(np.array(points_mm)), colour, name=name)


def _write_caption(trial: InsertionTrial, step: InsertionStep) -> str:
    target_mm, _ = trial.locate_places(step.frame)
    left_mm = math.dist(step.estimate_mm, target_mm[1:])
    time_s = step.t_s - trial.start_t_s
    return f"{step.depth_mm:.1f} mm inserted, {time_s:.0f} s, {left_mm:.1f} mm to the target"


def _write_end(trial: InsertionTrial) -> str:
    if trial.target_error_mm is None:
        return f"{trial.outcome}: not measured"
    return f"{trial.outcome}: {trial.target_error_mm:.2f} mm from the target in the plane"
