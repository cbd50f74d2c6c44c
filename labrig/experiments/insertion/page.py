"""The page of an insertion run: figure 9 of the paper, and the estimated tip along the way."""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from markupsafe import Markup

from labrig.analysis.pictures import load_plane_map
from labrig.analysis.result import AnalysisResult
from labrig.experiments.insertion import ending
from labrig.experiments.insertion.events import BevelTurn, InsertionRole, InsertionStart, PathSought
from labrig.experiments.insertion.figure import draw_insertion_figure
from labrig.experiments.insertion.protocol import InsertionProtocol
from labrig.experiments.insertion.result import InsertionResult, InsertionTrial, describe_nis, describe_radius
from labrig.experiments.insertion.scene import FloatArray, Scene, make_films, read_scenes
from labrig.experiments.shared.roll_zero_events import RollZeroFound
from labrig.record.events import Event
from labrig.record.reader import Run
from labrig.report.film_pictures import Stroke
from labrig.report.page import Page, read_world
from labrig.report.pictures import PLATE, Plate, map_path, photograph, pixel, polyline, scale_bar
from labrig.vision.out_of_plane import Perspective
from labrig.vision.plane import PlaneMap

__all__ = ["TEMPLATE", "make_films", "make_page"]

TEMPLATE = Path(__file__).with_name("page.html.jinja")
# At most this many insertions are shown picture by picture, misses first.
_SHOWN = 4
_MOST_PANELS = 8
_BEHIND_MM, _RING_MM = 0.1, 0.4


@dataclass(frozen=True)
class Panel:
    """One picture of figure 9: depth and time, why it is shown, and the picture with its lines."""

    title: str
    occasion: str
    picture: Plate
    target: str = ""
    """The part of the picture about the target, as an SVG view box."""


@dataclass(frozen=True)
class ShownInsertion:
    """One insertion: its pictures, and its curves over the inserted length."""

    trial: InsertionTrial
    panels: tuple[Panel, ...]
    figure: Markup | None
    planned_mm: float | None
    """How far from the target its last path was planned to end."""


def make_page(run: Run, protocol: InsertionProtocol, result: AnalysisResult[InsertionResult]) -> Page:
    """Return the page of an insertion: figure 9, the errors, and the estimated tip along the way."""
    content, plane, events = result.content, load_plane_map(run), read_scenes(run)
    shown = sorted(content.insertions, key=lambda trial: (trial.reached is True, trial.trial))[:_SHOWN]
    noise = vars(content.sighting_noise) if content.sighting_noise else None
    parts = {
        "budgets": {
            "Error in the plane, by the shaft": [trial.target_error_budget_mm for trial in content.insertions]
        },
        "shown": [
            _draw_insertion(run, protocol, trial, events.get(trial.trial, ()), Scene(plane))
            for trial in sorted(shown, key=lambda trial: trial.trial)
        ],
        "turns": run.read_events(BevelTurn),
        "zeros": run.read_events(InsertionStart, RollZeroFound),
        "degrees": math.degrees,
        "noise_told": describe_nis(noise),
        "ending": ending,
        "radius_told": describe_radius(noise, content.settings),
    }
    return Page(TEMPLATE, plane, parts)


def _draw_insertion(
    run: Run, protocol: InsertionProtocol, trial: InsertionTrial, events: Sequence[Event], scene: Scene
) -> ShownInsertion:
    plans = [event for event in events if isinstance(event, PathSought)]
    predicts = protocol.estimator.method != "paper"
    true_mm, panels, world = None if trial.markers else trial.true_target_mm, list[Panel](), read_world(run)
    moved_mm = true_mm if world.get("target_moves_mm") else None
    # What the map is off at a target that has not moved, it is off along the true path too.
    placed_mm = trial.target_mm if true_mm is None or moved_mm else true_mm
    map_truth = partial(map_path, true_mm=placed_mm[1:], mapped_mm=trial.target_mm[1:])
    figure = draw_insertion_figure(trial, plans, map_truth, predicts=predicts) if trial.steps else None
    for event in events:
        scene.take(event)
        if isinstance(event, PathSought) and any(event is plan for plan in _select_plans(plans)):
            frame = _find_scene(run, trial) if event.frame is None else event.frame
            strokes = *scene.draw_places(), *scene.former, *scene.draw_ways()
            title = f"{event.depth_mm:.1f} mm inserted, {event.t_s - trial.start_t_s:.0f} s"
            panels += _draw_panel(run, frame, strokes, scene.plane, (title, event.because))
    final = trial.final_frame if panels or trial.final_frame is not None else _find_scene(run, trial)
    if final is not None and scene.start is not None:
        at_s = run.frame_lines[final].t_s - trial.start_t_s
        strokes = (
            *scene.draw_places(),
            *[*scene.former, *scene.draw_line("former", scene.plan_mm)][:1],
            *scene.draw_line("taken", trial.shaft_mm or scene.taken_mm),
            *scene.draw_line("true", map_truth([place_mm[1:] for place_mm in trial.true_path_mm])),
            *(_draw_obstacles(trial, scene, map_truth) if world.get("obstacle_shift_sd_mm") else ()),
            *([scene.draw_ring("moved", moved_mm[1:], trial.tolerance_mm)] if moved_mm else ()),
            *_draw_end(trial, scene),
            *_draw_circle(protocol, trial, scene),
        )
        inserted = f"{trial.length_mm or 0.0:.1f} mm inserted, {at_s:.0f} s"
        title = inserted if final == trial.final_frame else "not inserted"
        panels += _draw_panel(run, final, strokes, scene.plane, (title, trial.stop))
    return ShownInsertion(trial, tuple(panels), figure, plans[-1].plan.target_error_mm if plans else None)


def _draw_end(trial: InsertionTrial, scene: Scene) -> Iterator[Stroke]:
    """Yield the needle's end where it was measured, and a line to there from where it is seen, if that is elsewhere."""
    if trial.tip_mm is not None:
        end_mm, perspective = np.array(trial.tip_mm), Perspective.of(scene.plane)
        if perspective is not None and trial.depth is not None and trial.depth.contradicts:
            end_mm = end_mm + trial.depth.x_mm * perspective.find_slope(end_mm)
            yield from scene.draw_line("sight", np.array((trial.tip_mm, end_mm)))
        yield scene.draw_ring("tip", end_mm.tolist(), _RING_MM)


def _draw_obstacles(trial: InsertionTrial, scene: Scene, put: Callable[..., FloatArray]) -> Iterator[Stroke]:
    """Yield the obstacles of a gel that has them elsewhere than the protocol, where the camera sees them."""
    perspective = Perspective.of(scene.plane)
    for ball in trial.true_obstacles:
        (seen_mm,) = put([ball.position_mm[1:]])
        slope = np.zeros(2) if perspective is None else perspective.find_slope(seen_mm)
        yield scene.draw_ring("placed", (seen_mm - ball.position_mm[0] * slope).tolist(), ball.radius_mm)


def _draw_circle(protocol: InsertionProtocol, trial: InsertionTrial, scene: Scene) -> Iterator[Stroke]:
    """Yield the tightest turn towards a target inside it: from the start, or from where it left no path.

    It begins where a turn of the bevel acts.
    """
    radius_mm, start_mm, heading_rad, at_mm = protocol.planner.radius_mm, (0.0, 0.0), 0.0, 0.0
    if trial.refused == "turning_circle" and (last := scene.last) is not None:
        start_mm, heading_rad, at_mm = last.estimate_mm, last.heading_rad, last.depth_mm
        radius_mm = last.radius_mm or radius_mm
    cosine, sine = math.cos(heading_rad), math.sin(heading_rad)
    acts_mm = np.add(start_mm, (protocol.policy.find_acting_mm(at_mm) - at_mm) * np.array((sine, cosine)))
    aside = np.array((cosine, -sine))
    centre_mm = acts_mm + math.copysign(radius_mm, aside @ (trial.target_mm[1:] - acts_mm)) * aside
    if math.dist(centre_mm, trial.target_mm[1:]) < radius_mm:
        yield scene.draw_ring("turning", centre_mm.tolist(), radius_mm)


def _select_plans(plans: Sequence[PathSought]) -> list[PathSought]:
    """Return the plans that are shown: those that were found anew, of those near the target only the first."""
    anew = any(plan.because == "origin" for plan in plans)
    # A path from behind the picture is the one before: the search found none.
    fresh = [plan for plan in plans if plan.plan.found and plan.from_mm > plan.depth_mm - _BEHIND_MM]
    found = [plan for plan in fresh if not (anew and plan.because == "start")]
    near = next((plan for plan in found if plan.because == "near"), None)
    kept = [plan for plan in found if plan.because != "near" or plan is near]
    chosen = np.linspace(0, len(kept) - 1, min(len(kept), _MOST_PANELS - 1)).round().astype(int)
    return [kept[place] for place in chosen]


def _find_scene(run: Run, trial: InsertionTrial) -> int | None:
    """Return the last frame before a trial with the needle in its sheath, or its own before the needle moved."""
    own = (InsertionRole.SCENE, trial.trial)
    before = (line for line in run.frame_lines if line.t_s <= trial.start_t_s and not line.insertion_mm)
    scenes = (line for line in run.frame_lines if (line.role, line.trial) == own)
    return max((line.frame for line in (*before, *scenes)), default=None)


def _draw_panel(
    run: Run, frame: int | None, strokes: Sequence[Stroke], plane: PlaneMap, told: tuple[str, str]
) -> Iterator[Panel]:
    """Yield a picture with these lines over it, its title and its occasion; nothing if it cannot be read."""
    plate = None if frame is None else photograph(run, frame, PLATE)
    if plate is not None:
        lines = [(stroke.name, polyline(stroke.px)) for stroke in strokes]
        words, bar = [(told[0], (0.02 * plate.width, 0.04 * plate.width))], scale_bar(plate.size, plane)
        obstacles = [stroke.px.mean(axis=0) for stroke in strokes if stroke.name == "obstacle"]
        words += [(str(number), pixel(px)) for number, px in enumerate(obstacles, start=1)]
        at_target = [stroke.px for stroke in strokes if stroke.name in {"target", "moved", "tip"}]
        yield Panel(*told, replace(plate, lines=lines, words=words, bar=bar), _frame(at_target))


def _frame(outlines: Sequence[FloatArray]) -> str:
    """Return the view box about these outlines, twice as wide; empty without one."""
    if not outlines:
        return ""
    px = np.concatenate(outlines)
    (left, top), half = (px.min(axis=0) + px.max(axis=0)) / 2, float(np.ptp(px, axis=0).max())
    return f"{left - 1.4 * half:.1f} {top - half:.1f} {2.8 * half:.1f} {2 * half:.1f}"
