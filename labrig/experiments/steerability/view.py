"""A sweep in the rerun viewer: the shaft in each picture, and the radius of each hole with what is known of its gel.

Of a run that was measured they are the result's. While a run is made, its pictures are measured as the analysis
measures them, but for what only the whole run tells: a sheath that was elsewhere, and the drift of the camera.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import partial

import rerun as rr

from labrig.analysis.pictures import load_mask_of_run, load_plane_map, measure_picture
from labrig.analysis.result import AnalysisResult
from labrig.experiments.shared.curvature import MEASURED_ROLES, describe_picture
from labrig.experiments.shared.curvature_result import CurvatureResult, PictureResult, SpecimenResult
from labrig.experiments.shared.grouping import summarise_specimens
from labrig.experiments.shared.needle_events import NeedleRole
from labrig.experiments.steerability.analysis import make_order
from labrig.experiments.steerability.events import SweepTrialStart
from labrig.experiments.steerability.protocol import SteerabilityProtocol
from labrig.protocol.load import load_recorded_protocol
from labrig.record.events import NO_DECISIONS, READ, Decisions, Event, FrameLine, TrialStop, parse_events
from labrig.record.following import RecordLines
from labrig.record.pictures import RecordedPicture
from labrig.record.reader import Run
from labrig.report.palette import mark
from labrig.report.rerun_view import draw_shaft, set_time
from labrig.report.view import View

_OVERVIEWS = (("/radii", "Radius of each hole, mean and 95 % interval of its gel (mm)"),)


@dataclass
class _Drawing:
    """Draws the radii of final pictures one after another."""

    roll_sd_deg: float
    trials: list[SweepTrialStart] = field(default_factory=list)
    decisions: Decisions = NO_DECISIONS
    finals: dict[int, PictureResult] = field(default_factory=dict)
    drawn: dict[str, SpecimenResult] = field(default_factory=dict)

    def draw_final(self, stream: rr.RecordingStream, measured: PictureResult, t_s: float) -> None:
        """Draw a final picture's radius, and what is known of its gel by now."""
        if measured.trial is None or self.decisions.explain_left_out(measured.trial):
            return
        self.finals[measured.trial] = measured
        self.draw_gels(stream, t_s)
        if measured.accepted and measured.radius_mm is not None and measured.specimen is not None:
            stream.log(_place(measured.specimen, "hole"), rr.Scalars(measured.radius_mm))

    def draw_gels(self, stream: rr.RecordingStream, t_s: float) -> None:
        """Draw mean and interval of each gel that has changed; trials that a person had left out do not count."""
        trials = [trial for trial in self.trials if not self.decisions.explain_left_out(trial.trial)]
        groups = summarise_specimens(trials, self.finals, self.roll_sd_deg)
        set_time(stream, t_s)
        for group in groups:
            if group.mean_radius_mm is not None and not _is_alike(group, self.drawn.get(group.name)):
                self._draw_gel(stream, group, group.mean_radius_mm)

    def _draw_gel(self, stream: rr.RecordingStream, group: SpecimenResult, mean_mm: float) -> None:
        if group.name not in self.drawn:
            self._begin_gel(stream, group.name)
        self.drawn[group.name] = group
        stream.log(_place(group.name, "mean"), rr.Scalars(mean_mm))
        for name, bound_mm in zip(("low", "high"), group.ci95_mm or (), strict=False):
            stream.log(_place(group.name, name), rr.Scalars(bound_mm))

    def _begin_gel(self, stream: rr.RecordingStream, gel: str) -> None:
        """Give a gel its colour: points for its holes, a line for the mean, thin ones for the interval."""
        colour = mark(len(self.drawn)).rgba
        points = rr.SeriesPoints(colors=[colour], marker_sizes=[5.0], markers=["circle"], names=[gel])
        stream.log(_place(gel, "hole"), points, static=True)
        for name, width in (("mean", 2.5), ("low", 1.0), ("high", 1.0)):
            line = rr.SeriesLines(colors=[colour], widths=[width], names=[gel])
            stream.log(_place(gel, name), line, static=True)


def make_view(run: Run, result: AnalysisResult[CurvatureResult]) -> View:
    """Return the radii of a result; the record's view draws its shafts."""
    drawing = _Drawing(_load_protocol(run).analysis.roll_sd_deg)
    return View(send=partial(_send, run, result.content, drawing), overviews=_OVERVIEWS)


def follow(run: Run) -> View:
    """Return shafts and radii of a run that is being made, measured here."""
    protocol = _load_protocol(run)
    drawing = _Drawing(protocol.analysis.roll_sd_deg)
    return View(
        follow=_Measuring(run, protocol, drawing).draw,
        overviews=_OVERVIEWS,
        needs=_is_final,
    )


def _is_final(line: FrameLine) -> bool:
    return line.role == NeedleRole.FINAL


def _load_protocol(run: Run) -> SteerabilityProtocol:
    protocol = load_recorded_protocol(run.protocol_path, {"steerability": SteerabilityProtocol})
    assert isinstance(protocol, SteerabilityProtocol)
    return protocol


def _send(
    run: Run, content: CurvatureResult, drawing: _Drawing, stream: rr.RecordingStream, _timeline: str
) -> None:
    drawing.trials += [trial.start for trial in run.read_trials(SweepTrialStart, TrialStop)]
    drawing.decisions = run.decisions
    for measured in content.measurements:
        if measured.role == NeedleRole.FINAL:
            drawing.draw_final(stream, measured, run.frame_lines[measured.frame].t_s)


class _Measuring:
    """Measures pictures as they come."""

    def __init__(self, run: Run, protocol: SteerabilityProtocol, drawing: _Drawing) -> None:
        self._run = run
        self._plane = load_plane_map(run)
        self._settings = make_order(protocol).settings
        self._mask = load_mask_of_run(run)
        self._drawing = drawing

    def draw(self, stream: rr.RecordingStream, _timeline: str, lines: RecordLines) -> None:
        """Measure the pictures of the needle, and draw shaft and radius."""
        events = parse_events(self._run.path, lines.events, (SweepTrialStart, *READ))
        told_in_order: list[Event | RecordedPicture] = [*events, *lines.pictures]
        for told in sorted(told_in_order, key=_time_of):
            match told:
                case SweepTrialStart():
                    self._drawing.trials.append(told)
                case Event():
                    self._drawing.decisions = self._drawing.decisions.add(told)
                    self._drawing.draw_gels(stream, told.t_s)
                case RecordedPicture() if told.line.role in MEASURED_ROLES:
                    self._draw_measured(stream, told)
                case RecordedPicture():
                    set_time(stream, told.line.t_s)
                    draw_shaft(stream, [])

    def _draw_measured(self, stream: rr.RecordingStream, picture: RecordedPicture) -> None:
        measured = measure_picture(picture, self._plane, self._settings, self._mask)
        set_time(stream, picture.line.t_s)
        draw_shaft(stream, [] if measured.line is None else [measured.line.px])
        trial = _find_trial(self._drawing.trials, picture.line.trial)
        if _is_final(picture.line):
            result = describe_picture(picture.line, trial, measured)
            self._drawing.draw_final(stream, result, picture.line.t_s)


def _time_of(told: Event | RecordedPicture) -> float:
    return told.line.t_s if isinstance(told, RecordedPicture) else told.t_s


def _find_trial(trials: Iterable[SweepTrialStart], number: int | None) -> SweepTrialStart | None:
    return next((trial for trial in trials if trial.trial == number), None)


def _place(gel: str, name: str) -> str:
    return rr.new_entity_path(["radii", gel, name])


def _is_alike(group: SpecimenResult, other: SpecimenResult | None) -> bool:
    return other is not None and (group.mean_radius_mm, group.ci95_mm) == (
        other.mean_radius_mm,
        other.ci95_mm,
    )
