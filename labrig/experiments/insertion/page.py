"""The page of an insertion run: figure 9 of the paper, and the estimated tip along the way."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup

from labrig.analysis.pictures import load_plane_map
from labrig.analysis.result import AnalysisResult
from labrig.errors import RecordError
from labrig.experiments.insertion.events import InsertionRole, PathSought
from labrig.experiments.insertion.figure import draw_insertion_figure
from labrig.experiments.insertion.protocol import InsertionProtocol
from labrig.experiments.insertion.result import InsertionResult, InsertionTrial
from labrig.experiments.insertion.scene import Scene, make_films, read_scenes
from labrig.experiments.insertion.summary import describe_sighting_noise
from labrig.record.events import Event
from labrig.record.reader import Run
from labrig.report.film_pictures import Stroke
from labrig.report.formatting import Rows, number
from labrig.report.page import Page
from labrig.report.pictures import PLATE, Photograph, Pixel, photograph, polyline, scale_bar
from labrig.text import format_count
from labrig.vision.plane import PlaneMap

TEMPLATE = Path(__file__).with_name("page.html.jinja")
# At most this many insertions are shown picture by picture, misses first.
_SHOWN = 4
_MOST_PANELS = 8
_OCCASIONS = {
    "start": "the first plan",
    "origin": "planned from where the sheath was found",
    "markers": "planned to where the markers have moved it",
    "schedule": "planned anew as the protocol says",
    "deviation": "planned anew: the rest of the path would have missed",
    "near": "planned anew near the target, as at each picture from here on",
}


@dataclass(frozen=True)
class Panel:
    """One picture of figure 9; its lines are names with the `points` of SVG polylines in the picture's pixels."""

    title: str
    occasion: str
    picture: Photograph
    lines: Sequence[tuple[str, str]]
    scale_mm: float
    scale: tuple[Pixel, Pixel]


@dataclass(frozen=True)
class ShownInsertion:
    """One insertion: its pictures, and its curves over the inserted length."""

    trial: InsertionTrial
    panels: tuple[Panel, ...]
    figure: Markup | None


def make_page(run: Run, protocol: InsertionProtocol, result: AnalysisResult[InsertionResult] | None) -> Page:
    """Return the page of an insertion: figure 9, the errors, and the estimated tip along the way."""
    facts = _list_facts(protocol)
    if result is None:
        return Page(facts)
    content, plane = result.content, load_plane_map(run)
    shown = _collect_content(run, content, plane)
    return Page(
        facts, TEMPLATE, _write_verdict(content), plane, shown, partial(make_films, run, content, plane)
    )


def _list_facts(protocol: InsertionProtocol) -> Rows:
    return (
        ("Needle", f"{protocol.needle.needle_id}, {protocol.needle.diameter_mm:g} mm"),
        ("Gel", f"{protocol.specimen.gelatin_percent:g} %"),
        ("Obstacles", str(len(protocol.obstacles))),
        ("Tolerance", f"{protocol.target.tolerance_mm:g} mm"),
        ("Insertion speed", f"{protocol.insertion.speed_mm_s:g} mm/s"),
        ("Planner, estimator", f"{protocol.planner.method}, {protocol.estimator.method}"),
    )


def _collect_content(run: Run, content: InsertionResult, plane: PlaneMap) -> dict[str, Any]:
    events = read_scenes(run)
    shown = sorted(content.insertions, key=lambda trial: (trial.reached is True, trial.trial))[:_SHOWN]
    return {
        "budgets": {"Error at the target": [trial.target_error_budget_mm for trial in content.insertions]},
        "sources": [trial for trial in content.insertions if trial.target_error_sources_mm is not None],
        "markers": [trial for trial in content.insertions if trial.markers],
        "simulated": any(trial.true_target_error_mm is not None for trial in content.insertions),
        "shown": [
            _draw_insertion(run, trial, events.get(trial.trial, ()), plane)
            for trial in sorted(shown, key=lambda trial: trial.trial)
        ],
        "left_out": max(0, len(content.insertions) - _SHOWN),
        "noise_told": describe_sighting_noise(
            None if content.sighting_noise is None else vars(content.sighting_noise)
        ),
        "causes": [(count, name.replace("_", " ")) for name, count in content.causes.items()],
    }


def _write_verdict(content: InsertionResult) -> list[str]:
    """Return the page in a sentence or two."""
    if not content.made:
        return ["No insertion was begun."]
    several, sentences = content.made > 1, list[str]()
    sentences.append(f"{content.arrived} of {format_count(content.made, 'insertion')} reached the target.")
    open_ones = sum(trial.reached is None for trial in content.insertions)
    if open_ones:
        sentences.append(
            f"{format_count(open_ones, 'insertion')} ended within the tolerance in the plane; whether in space too, "
            "one camera does not tell."
        )
    if content.target_error_mm is not None:
        where = "is never further than" if several else "is"
        sigma_mm = None if several else content.insertions[0].sigma_target_error_mm
        sure = "" if sigma_mm is None else f" (standard deviation {number(sigma_mm)} mm)"
        sentences.append(
            f"Measured by the shaft in the final picture, the needle's end {where} "
            f"{number(content.target_error_mm)} mm from it{sure}."
        )
    if content.target_error_interval_mm is not None:
        which = "the least certain insertion" if several else "it"
        low, high = map(number, content.target_error_interval_mm)
        sentences.append(
            f"That is the distance in the plane; in space, {which} ended between {low} and {high} mm from the target "
            f"with a probability of 95 %."
        )
    if content.true_target_error_mm is not None:
        most, least = ("at most ", "at least ") if several else ("", "")
        sentences.append(
            f"The rig is simulated: the true error is {most}{number(content.true_target_error_mm)} mm, and "
            f"the needle kept {least}{number(content.true_min_clearance_mm)} mm off the obstacles."
        )
    return [" ".join(sentences)]


def _draw_insertion(
    run: Run, trial: InsertionTrial, events: Sequence[Event], plane: PlaneMap
) -> ShownInsertion:
    plans = [event for event in events if isinstance(event, PathSought)]
    figure = draw_insertion_figure(trial, plans, f"trial{trial.trial}") if trial.steps else None
    panels, scene = list[Panel](), Scene(plane)
    for event in events:
        scene.take(event)
        if isinstance(event, PathSought) and any(event is plan for plan in _select_plans(plans)):
            frame = _find_scene(run, trial.trial) if event.frame is None else event.frame
            strokes = *scene.draw_places(), *scene.former, *scene.draw_ways()
            title = f"{event.depth_mm:.1f} mm, {event.t_s - trial.start_t_s:.0f} s"
            panels += _draw_panel(run, frame, strokes, plane, (title, _OCCASIONS[event.because]))
    if trial.final_frame is not None:
        seconds = run.frame_lines[trial.final_frame].t_s - trial.start_t_s
        strokes = (
            *scene.draw_places(),
            *scene.former,
            *scene.draw_line("former", scene.plan_mm),
            *scene.draw_line("taken", trial.shaft_mm or scene.taken_mm),
            *scene.draw_line("true", trial.true_path_mm),
        )
        told = f"{trial.length_mm or 0.0:.1f} mm, {seconds:.0f} s", f"stopped, {trial.cause}"
        panels += _draw_panel(run, trial.final_frame, strokes, plane, told)
    return ShownInsertion(trial, tuple(panels), figure)


def _select_plans(plans: Sequence[PathSought]) -> list[PathSought]:
    """Return the plans that are shown: those that were found, of those near the target only the first."""
    anew = any(plan.because == "origin" for plan in plans)
    found = [plan for plan in plans if plan.found and not (anew and plan.because == "start")]
    near = next((plan for plan in found if plan.because == "near"), None)
    kept = [plan for plan in found if plan.because != "near" or plan is near]
    chosen = np.linspace(0, len(kept) - 1, min(len(kept), _MOST_PANELS - 1)).round().astype(int)
    return [kept[place] for place in chosen]


def _find_scene(run: Run, trial: int) -> int | None:
    """Return the frame taken before the needle moved."""
    own = [line for line in run.frame_lines if (line.role, line.trial) == (InsertionRole.SCENE, trial)]
    return own[-1].frame if own else None


def _draw_panel(
    run: Run, frame: int | None, strokes: Sequence[Stroke], plane: PlaneMap, told: tuple[str, str]
) -> Iterator[Panel]:
    """Yield a picture with these lines over it, its title and its occasion; nothing if it cannot be read."""
    if frame is None:
        return
    try:
        picture = photograph(run.read_frame(frame), PLATE)
    except RecordError:
        return
    lines = [(stroke.name, polyline(stroke.px)) for stroke in strokes]
    yield Panel(*told, picture, lines, *scale_bar((picture.width, picture.height), plane))
