"""An insertion in the rerun viewer: target, plan and path in the pictures, and curves of the estimate."""

import math
from collections.abc import Sequence
from functools import partial

import numpy as np
import rerun as rr

from labrig.analysis.calibration import load_plane_map
from labrig.analysis.result import AnalysisResult
from labrig.experiments.insertion.result import InsertionResult, InsertionStep, InsertionTrial
from labrig.record.reader import Run
from labrig.report.pictures import circle
from labrig.report.view import View
from labrig.vision.plane import PlaneMap

_OBSTACLE, _TARGET, _PLAN, _TAKEN = (213, 94, 0), (0, 158, 115), (255, 166, 0), (86, 180, 233)
_DRAWN = ("obstacles", "target", "plan", "taken", "tip")


def make_view(run: Run, result: AnalysisResult[InsertionResult]) -> View:
    """Return the curves of the estimate and the drawings in the pictures."""
    plane = load_plane_map(run)
    return View((("/estimate", "Tip (mm, degrees)"),), partial(_send, result.content, plane))


def _send(content: InsertionResult, plane: PlaneMap, stream: rr.RecordingStream, timeline: str) -> None:
    """Send target, plans, observations and estimates, each at its rig time [s]."""
    for trial in content.insertions:
        stream.set_time(timeline, duration=trial.start_t_s)
        _send_scene(stream, trial, plane)
        for plan in trial.plans:
            stream.set_time(timeline, duration=plan.t_s)
            if plan.path_mm:
                _send_line(stream, "plan", plan.path_mm, plane, _PLAN)
        for number, step in enumerate(trial.steps, start=1):
            stream.set_time(timeline, duration=step.t_s)
            _send_line(stream, "taken", [step.estimate_mm for step in trial.steps[:number]], plane, _TAKEN)
            _send_step(stream, step, plane)
        if trial.steps and trial.final_frame is not None:
            _send_end(stream, trial)


def _send_scene(stream: rr.RecordingStream, trial: InsertionTrial, plane: PlaneMap) -> None:
    for name in _DRAWN:
        stream.log(f"/camera/{name}", rr.Clear(recursive=False))
    rings = [circle(ball.position_mm[1:], ball.radius_mm, plane) for ball in trial.obstacles]
    if rings:
        stream.log("/camera/obstacles", rr.LineStrips2D(rings, colors=[_OBSTACLE] * len(rings), radii=1.0))
    target = circle(trial.target_mm[1:], trial.tolerance_mm, plane)
    stream.log("/camera/target", rr.LineStrips2D([target], colors=[_TARGET], radii=1.0))


def _send_step(stream: rr.RecordingStream, step: InsertionStep, plane: PlaneMap) -> None:
    """Send the observed tip, if any, and the numbers of the estimate."""
    seen = np.empty((0, 2)) if step.tip_mm is None else plane.to_px([step.tip_mm])
    stream.log("/camera/tip", rr.Points2D(seen, colors=[_TARGET] * len(seen), radii=4.0))
    numbers = {
        "heading_deg": math.degrees(step.heading_rad),
        "nis": step.nis,
        "innovation_mm": None if step.innovation_mm is None else math.hypot(*step.innovation_mm),
        "clearance_mm": step.clearance_mm,
        "error_mm": None if step.true_mm is None else math.dist(step.estimate_mm, step.true_mm),
    }
    for name, value in numbers.items():
        if value is not None:
            stream.log(f"/estimate/{name}", rr.Scalars(value))


def _send_end(stream: rr.RecordingStream, trial: InsertionTrial) -> None:
    error = (
        "not measured" if trial.target_error_mm is None else f"{trial.target_error_mm:.2f} mm from the target"
    )
    stream.log("/events", rr.TextLog(f"insertion {trial.trial + 1}: {trial.outcome}, {error}"))


def _send_line(
    stream: rr.RecordingStream,
    name: str,
    path_mm: Sequence[tuple[float, float]],
    plane: PlaneMap,
    colour: tuple[int, int, int],
) -> None:
    line = plane.to_px(np.array(path_mm))
    stream.log(f"/camera/{name}", rr.LineStrips2D([line], colors=[colour], radii=1.0))
