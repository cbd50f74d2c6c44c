"""An insertion in the rerun viewer: target, plan and path in the pictures, and curves of the estimate, as recorded."""

import math
from collections.abc import Mapping
from functools import partial
from itertools import groupby
from operator import attrgetter
from pathlib import Path
from typing import Any

import rerun as rr

from labrig.analysis.pictures import load_plane_map
from labrig.analysis.result import AnalysisResult
from labrig.experiments.insertion.events import NIS_95, TipObserved
from labrig.experiments.insertion.result import InsertionResult
from labrig.experiments.insertion.scene import COLOURS, KINDS, Scene
from labrig.protocol.yaml_text import load_yaml_values
from labrig.record.events import Event, parse_events
from labrig.record.following import RecordLines
from labrig.record.reader import Run
from labrig.report.rerun_view import CAMERA, set_time
from labrig.report.view import View

_CURVES = (("/error", "Error (mm)"), ("/nis", "NIS of the sightings (2 expected)"))
_ADDED = (
    "error/seen - predicted", "nis/NIS", "nis/95 % below",
    "depth/to the target", "depth/to an obstacle", "roll/heading",
)  # fmt: skip
_WORDS: Mapping[str, Any] = load_yaml_values(Path(__file__).with_name("event_words.yaml"))
_PLACES = tuple(rr.new_entity_path(name.split("/")) for name in _ADDED)


def make_view(run: Run, _result: AnalysisResult[InsertionResult]) -> View:
    """Return the curves of the estimate and the drawings in the pictures."""
    return View(_CURVES, partial(_send, run), words=_WORDS, added=_PLACES)


def follow(run: Run) -> View:
    """Return the same of a run that is being made."""
    scene = Scene(load_plane_map(run))
    return View(_CURVES, follow=partial(_follow, run, scene), words=_WORDS, added=_PLACES)


def _send(run: Run, stream: rr.RecordingStream, _timeline: str) -> None:
    scene = Scene(load_plane_map(run))
    for event in run.read_events(*KINDS):
        _draw(stream, scene, event)


def _follow(run: Run, scene: Scene, stream: rr.RecordingStream, _timeline: str, lines: RecordLines) -> None:
    for event in parse_events(run.path, lines.events, KINDS):
        _draw(stream, scene, event)


def _draw(stream: rr.RecordingStream, scene: Scene, event: Event) -> None:
    """Draw what stands in the pictures after an event, and the numbers of an estimate."""
    scene.take(event)
    if scene.start is None:
        return
    set_time(stream, event.t_s)
    strokes = [*scene.draw_places(), *scene.draw_ways(), *scene.draw_tip()]
    name_of = attrgetter("name")
    by_name = {name: list(own) for name, own in groupby(sorted(strokes, key=name_of), name_of)}
    for name, colour in COLOURS.items():
        lines = [stroke.px for stroke in by_name.get(name, ())]
        stream.log(f"{CAMERA}/{name}", rr.LineStrips2D(lines, colors=[colour] * len(lines), radii=1.0))
    if isinstance(event, TipObserved):
        _draw_numbers(stream, scene, event)


def _draw_numbers(stream: rr.RecordingStream, scene: Scene, step: TipObserved) -> None:
    obstacles = scene.locate().obstacles
    gaps_mm = [math.dist(step.estimate_mm, ball.position_mm[1:]) - ball.radius_mm for ball in obstacles]
    values = (
        None if step.innovation_mm is None else math.hypot(*step.innovation_mm),
        step.nis,
        NIS_95,
        scene.left_mm,
        min(gaps_mm, default=None),
        math.degrees(step.heading_rad),
    )
    for place, value in zip(_PLACES, values, strict=True):
        if value is not None:
            stream.log(place, rr.Scalars(value))
