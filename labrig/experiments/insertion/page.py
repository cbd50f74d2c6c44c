"""The page of an insertion run: figure 9 of the paper, and the estimated tip along the way."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from labrig.analysis.pictures import load_plane_map
from labrig.analysis.result import AnalysisResult, Point
from labrig.errors import RecordError
from labrig.experiments.insertion.events import InsertionRole, PathSought
from labrig.experiments.insertion.figure import draw_insertion_figure
from labrig.experiments.insertion.film import make_films
from labrig.experiments.insertion.protocol import InsertionProtocol
from labrig.experiments.insertion.recorded_plan import read_plans, sample_plan
from labrig.experiments.insertion.result import InsertionResult, InsertionTrial
from labrig.experiments.insertion.summary import describe_places, describe_sighting_noise
from labrig.record.reader import Run
from labrig.report.formatting import Rows, number
from labrig.report.page import Page
from labrig.report.pictures import PLATE, Pixel, circle, data_uri, jpeg, pixel, polyline, scale_bar
from labrig.text import format_count
from labrig.vision.picture import size_of
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
    """One picture of figure 9; every line is the `points` of an SVG polyline in the recorded picture's pixels."""

    title: str
    occasion: str
    href: str
    width: int
    height: int
    text_px: float
    plan: str
    former: tuple[str, ...]
    taken: str
    truth: str
    obstacles: tuple[str, ...]
    tolerance: str
    target: Pixel
    scale_mm: float
    scale: tuple[Pixel, Pixel]


@dataclass(frozen=True)
class ShownInsertion:
    """One insertion: its pictures, and its curves over the inserted length."""

    trial: InsertionTrial
    panels: tuple[Panel, ...]
    figure: Markup | None


@dataclass(frozen=True)
class _Moment:
    """A picture to show: its frame, time, depth and occasion, and the plans up to then."""

    frame: int
    t_s: float
    depth_mm: float
    occasion: str
    plans: Sequence[PathSought]


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
    plans = read_plans(run)
    shown = sorted(content.insertions, key=lambda trial: (trial.reached is True, trial.trial))[:_SHOWN]
    return {
        "budgets": {"Error at the target": [trial.target_error_budget_mm for trial in content.insertions]},
        "sources": [trial for trial in content.insertions if trial.target_error_sources_mm is not None],
        "markers": [trial for trial in content.insertions if trial.markers],
        "places": _describe_places(content.insertions),
        "simulated": any(trial.true_target_error_mm is not None for trial in content.insertions),
        "shown": [
            _draw_insertion(run, trial, plans.get(trial.trial, ()), plane)
            for trial in sorted(shown, key=lambda trial: trial.trial)
        ],
        "left_out": max(0, len(content.insertions) - _SHOWN),
        "noise_told": describe_sighting_noise(
            None if content.sighting_noise is None else content.sighting_noise.model_dump()
        ),
        "causes": [(count, name.replace("_", " ")) for name, count in content.causes.items()],
    }


def _describe_places(trials: Sequence[InsertionTrial]) -> str | None:
    return describe_places(
        [(trial.trial, by) for trial in trials if (by := trial.target_error_interval_by) is not None]
    )


def _write_verdict(content: InsertionResult) -> list[str]:
    """Return the page in a sentence or two."""
    if not content.made:
        return ["No insertion was begun."]
    sentences = [f"{content.arrived} of {format_count(content.made, 'insertion')} reached the target."]
    several = content.made > 1
    open_ones = sum(trial.reached is None for trial in content.insertions)
    if open_ones:
        sentences.append(
            f"{format_count(open_ones, 'insertion')} ended within the tolerance in the plane; whether in space too, "
            "one camera does not tell."
        )
    if content.target_error_mm is not None:
        where = "is never further than" if several else "is"
        sentences.append(
            f"Measured by the shaft in the final picture, the needle's end {where} "
            f"{number(content.target_error_mm)} mm from it{_format_uncertainty(content)}."
        )
    if content.target_error_interval_mm is not None:
        which = "the least certain insertion" if several else "it"
        low, high = map(number, content.target_error_interval_mm)
        widest = [
            trial
            for trial in content.insertions
            if trial.target_error_interval_mm == content.target_error_interval_mm
        ]
        places = _describe_places(widest)
        sentences.append(
            f"That is the distance in the plane; in space, {which} ended between {low} and {high} mm from the target "
            f"with a probability of 95 %{'' if places is None else f', {places}'}."
        )
    if content.true_target_error_mm is not None:
        most, least = ("at most ", "at least ") if several else ("", "")
        sentences.append(
            f"The rig is simulated: the true error is {most}{number(content.true_target_error_mm)} mm, and "
            f"the needle kept {least}{number(content.true_min_clearance_mm)} mm off the obstacles."
        )
    return [" ".join(sentences)]


def _format_uncertainty(content: InsertionResult) -> str:
    """Return the standard deviation of a single error as text; empty for several insertions, which have a table."""
    sigma_mm = content.insertions[0].sigma_target_error_mm if content.made == 1 else None
    return "" if sigma_mm is None else f" (standard deviation {number(sigma_mm)} mm)"


def _draw_insertion(
    run: Run, trial: InsertionTrial, plans: Sequence[PathSought], plane: PlaneMap
) -> ShownInsertion:
    drawn = (_draw_panel(run, moment, trial, plane) for moment in _list_moments(run, trial, plans))
    panels = tuple(panel for panel in drawn if panel is not None)
    figure = draw_insertion_figure(trial, plans, f"trial{trial.trial}") if trial.steps else None
    return ShownInsertion(trial, panels, figure)


def _list_moments(run: Run, trial: InsertionTrial, plans: Sequence[PathSought]) -> Iterator[_Moment]:
    """Yield the pictures of figure 9: one at each replan, but only the first near the target, and one at the end."""
    for index in _select_plans(plans):
        plan = plans[index]
        frame = _find_scene(run, trial.trial) if plan.frame is None else plan.frame
        if frame is not None:
            occasion = _OCCASIONS.get(plan.because, plan.because)
            yield _Moment(frame, plan.t_s - trial.start_t_s, plan.depth_mm, occasion, plans[: index + 1])
    if trial.final_frame is not None:
        t_s = run.frame_line(trial.final_frame).t_s
        yield _Moment(
            trial.final_frame,
            t_s - trial.start_t_s,
            trial.length_mm or 0.0,
            f"stopped, {trial.cause}",
            plans,
        )


def _select_plans(plans: Sequence[PathSought]) -> list[int]:
    anew = any(plan.because == "origin" for plan in plans)
    found = [
        index for index, plan in enumerate(plans) if plan.found and not (anew and plan.because == "start")
    ]
    near = [index for index in found if plans[index].because == "near"]
    kept = [index for index in found if plans[index].because != "near"] + near[:1]
    if len(kept) < _MOST_PANELS:
        return sorted(kept)
    chosen = np.linspace(0, len(kept) - 1, _MOST_PANELS - 1).round().astype(int)
    return [sorted(kept)[place] for place in chosen]


def _find_scene(run: Run, trial: int) -> int | None:
    """Return the frame taken before the needle moved."""
    own = [line for line in run.frame_lines if (line.role, line.trial) == (InsertionRole.SCENE, trial)]
    return own[-1].frame if own else None


def _draw_panel(run: Run, moment: _Moment, trial: InsertionTrial, plane: PlaneMap) -> Panel | None:
    """Return a picture with plan and path up to then; None if it cannot be read."""
    try:
        image = run.read_frame(moment.frame)
    except RecordError:
        return None
    width, height = size_of(image)
    taken = [step.estimate_mm for step in trial.steps if step.depth_mm <= moment.depth_mm + 1e-6]
    (_, *target_mm), obstacles = trial.locate_places(moment.frame)
    last = moment.frame == trial.final_frame
    scale_mm, scale = scale_bar((width, height), plane)
    return Panel(
        title=f"{moment.depth_mm:.1f} mm, {moment.t_s:.0f} s",
        occasion=moment.occasion,
        href=data_uri(jpeg(image, PLATE), "image/jpeg"),
        width=width,
        height=height,
        text_px=width / 40,
        plan="" if last or not moment.plans else _draw_path(sample_plan(moment.plans[-1]), plane),
        former=tuple(_draw_path(sample_plan(plan), plane) for plan in moment.plans[:-1] if plan.found),
        taken=_draw_path(trial.shaft_mm if last and trial.shaft_mm else taken, plane),
        truth=_draw_path(trial.true_path_mm, plane) if last else "",
        obstacles=tuple(polyline(circle(ball.position_mm[1:], ball.radius_mm, plane)) for ball in obstacles),
        tolerance=polyline(circle(target_mm, trial.tolerance_mm, plane)),
        target=pixel(plane.to_px([target_mm])[0]),
        scale_mm=scale_mm,
        scale=scale,
    )


def _draw_path(points_mm: Sequence[Point] | NDArray[np.float64], plane: PlaneMap) -> str:
    return polyline(plane.to_px(np.array(points_mm))) if len(points_mm) > 1 else ""
