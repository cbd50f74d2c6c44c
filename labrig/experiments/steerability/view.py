"""A sweep in the rerun viewer: the shaft in each picture, and the radius of each hole with what is known of its gel.

Of a run that was measured they are the result's. While a run is made, its pictures are measured as the analysis
measures them, but for what only the whole run tells: a sheath that was elsewhere, and the drift of the camera.
"""

import re
from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import partial

import rerun as rr

from labrig.analysis.calibration import load_mask_of_run, load_plane_map
from labrig.analysis.pictures import measure_picture
from labrig.analysis.result import AnalysisResult
from labrig.experiments.shared.curvature import MEASURED_ROLES, describe_picture
from labrig.experiments.shared.curvature_result import CurvatureResult, PictureResult, SpecimenResult
from labrig.experiments.shared.grouping import summarise_specimens
from labrig.experiments.shared.needle_events import NeedleRole
from labrig.experiments.steerability.analysis import make_order
from labrig.experiments.steerability.events import SweepTrialStart
from labrig.experiments.steerability.protocol import SteerabilityProtocol
from labrig.protocol.load import load_recorded_protocol
from labrig.record.events import FrameLine, TrialStop, parse_events
from labrig.record.following import LinedPicture, RecordLines
from labrig.record.reader import Run
from labrig.report.palette import mark
from labrig.report.record_drawing import draw_shaft, set_time
from labrig.report.view import View
from labrig.text import interval, number
from labrig.vision.curvature import CurvatureMeasurement

_OVERVIEWS = (("/radii", "Radius of each hole, mean and 95 % interval of its gel (mm)"),)
_DOCUMENTS = (("/gels", "Gels"),)


@dataclass
class _Drawing:
    """Draws the radii of final pictures one after another."""

    roll_sd_deg: float
    trials: list[SweepTrialStart] = field(default_factory=list)
    finals: dict[int, PictureResult] = field(default_factory=dict)
    gels: list[str] = field(default_factory=list)

    def draw_final(self, stream: rr.RecordingStream, measured: PictureResult, t_s: float) -> None:
        """Draw a final picture's radius, and what is known of its gel by now."""
        if measured.trial is None:
            return
        self.finals[measured.trial] = measured
        groups = summarise_specimens(self.trials, self.finals, self.roll_sd_deg)
        set_time(stream, t_s)
        stream.log("/gels", rr.TextDocument(_write_table(groups, measured), media_type="text/markdown"))
        group = next((group for group in groups if group.name == measured.specimen), None)
        if group is None or not measured.accepted or measured.radius_mm is None:
            return
        self._begin_gel(stream, group.name)
        values = {
            "hole": measured.radius_mm,
            "mean": group.mean_radius_mm,
            "low": None if group.ci95_mm is None else group.ci95_mm[0],
            "high": None if group.ci95_mm is None else group.ci95_mm[1],
        }
        for name, value in values.items():
            if value is not None:
                stream.log(_place(group.name, name), rr.Scalars(value))

    def _begin_gel(self, stream: rr.RecordingStream, gel: str) -> None:
        """Give a gel its colour: points for its holes, a line for the mean, thin ones for the interval."""
        if gel in self.gels:
            return
        colour = int(mark(len(self.gels)).colour.lstrip("#") + "ff", 16)
        self.gels.append(gel)
        points = rr.SeriesPoints(colors=[colour], marker_sizes=[5.0], markers=["circle"], names=[gel])
        stream.log(_place(gel, "hole"), points, static=True)
        for name, width in (("mean", 2.5), ("low", 1.0), ("high", 1.0)):
            line = rr.SeriesLines(colors=[colour], widths=[width], names=[gel])
            stream.log(_place(gel, name), line, static=True)


def make_view(run: Run, result: AnalysisResult[CurvatureResult]) -> View:
    """Return the radii of a result; the record's view draws its shafts."""
    drawing = _Drawing(_load_protocol(run).analysis.roll_sd_deg)
    return View(send=partial(_send, run, result.content, drawing), overviews=_OVERVIEWS, documents=_DOCUMENTS)


def follow(run: Run) -> View:
    """Return shafts and radii of a run that is being made, measured here."""
    protocol = _load_protocol(run)
    drawing = _Drawing(protocol.analysis.roll_sd_deg)
    return View(
        follow=_Measuring(run, protocol, drawing).draw,
        overviews=_OVERVIEWS,
        documents=_DOCUMENTS,
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
    for measured in content.measurements:
        if measured.role == NeedleRole.FINAL:
            drawing.draw_final(stream, measured, run.frame_line(measured.frame).t_s)


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
        self._drawing.trials += parse_events(self._run.path, lines.events, (SweepTrialStart,))
        for picture in lines.pictures:
            if picture.line.role in MEASURED_ROLES:
                self._draw_measured(stream, picture)
            else:
                set_time(stream, picture.line.t_s)
                draw_shaft(stream, [])

    def _draw_measured(self, stream: rr.RecordingStream, picture: LinedPicture) -> None:
        measured = measure_picture(picture.place, self._plane, self._settings, self._mask)
        line_px = [measured.centre_line_px] if isinstance(measured, CurvatureMeasurement) else []
        set_time(stream, picture.line.t_s)
        draw_shaft(stream, [px for px in line_px if len(px)])
        trial = _find_trial(self._drawing.trials, picture.line.trial)
        if _is_final(picture.line):
            result = describe_picture(picture.line, trial, measured)
            self._drawing.draw_final(stream, result, picture.line.t_s)


def _find_trial(trials: Iterable[SweepTrialStart], number: int | None) -> SweepTrialStart | None:
    return next((trial for trial in trials if trial.trial == number), None)


def _place(gel: str, name: str) -> str:
    return rr.new_entity_path(["radii", gel, name])


def _write_table(groups: Iterable[SpecimenResult], last: PictureResult) -> str:
    """Return the gels as a table in Markdown, under the last hole."""
    hole = f"hole {(last.hole or 0) + 1} of {_escape(str(last.specimen))}"
    found = f"{number(last.radius_mm, 2)} mm" if last.accepted else f"refused: {last.reason}"
    rows = (
        f"| {_escape(group.name)} | {group.n} | {number(group.mean_radius_mm, 2)} | {number(group.sd_radius_mm, 2)} "
        f"| {interval(group.ci95_mm)} | {group.refused} |"
        for group in groups
    )
    head = "| gel | n | mean radius mm | SD mm | 95 % interval mm | refused |\n|---|---|---|---|---|---|"
    return "\n".join((f"**Last: {hole}, {found}**", "", head, *rows))


def _escape(text: str) -> str:
    """Return a text in which Markdown finds nothing of its own."""
    return re.sub(r"([^\w\s])", r"\\\1", text)
