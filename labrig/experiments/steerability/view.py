"""A sweep in the rerun viewer: the shaft in each picture, and the radius of each hole.

Of a run that was measured they are the result's. While a run is made, its pictures are measured as the analysis
measures them, but for what only the whole run tells: a sheath that was elsewhere, and the drift of the camera.
"""

from collections.abc import Sequence
from functools import partial

import rerun as rr

from labrig.analysis.pictures import load_mask_of_run, load_plane_map, measure_picture
from labrig.analysis.result import AnalysisResult
from labrig.experiments.shared.curvature import MEASURED_ROLES, make_settings
from labrig.experiments.shared.curvature_result import CurvatureResult
from labrig.experiments.shared.needle_events import NeedleRole, SpecimenTrialStart
from labrig.experiments.steerability.protocol import SteerabilityProtocol
from labrig.protocol.load import load_recorded_protocol
from labrig.record.events import FrameLine, parse_events
from labrig.record.following import RecordLines
from labrig.record.pictures import RecordedPicture
from labrig.record.reader import Run
from labrig.report.palette import mark
from labrig.report.rerun_view import draw_shaft, set_time
from labrig.report.view import View
from labrig.vision.curvature import FloatArray

_OVERVIEWS = (("/radii", "Radius of each hole (mm)"),)


def _draw_radius(stream: rr.RecordingStream, gels: Sequence[str], gel: str, radius_mm: float) -> None:
    """Draw the radius in a hole of a gel, in the colour of that gel."""
    place, colour = rr.new_entity_path(["radii", gel]), mark(gels.index(gel)).rgba
    points = rr.SeriesPoints(colors=[colour], marker_sizes=[5.0], markers=["circle"], names=[gel])
    stream.log(place, points, static=True)
    stream.log(place, rr.Scalars(radius_mm))


def make_view(run: Run, result: AnalysisResult[CurvatureResult]) -> View:
    """Return the radii of a result; the record's view draws its shafts."""
    return View(send=partial(_send, run, result.content), overviews=_OVERVIEWS)


def _send(run: Run, content: CurvatureResult, stream: rr.RecordingStream, _timeline: str) -> None:
    gels = [gel.name for gel in content.specimens]
    for measured in content.measurements:
        is_final = measured.role == NeedleRole.FINAL and measured.accepted
        if is_final and measured.specimen is not None and measured.radius_mm is not None:
            set_time(stream, run.frame_lines[measured.frame].t_s)
            _draw_radius(stream, gels, measured.specimen, measured.radius_mm)


def follow(run: Run) -> View:
    """Return shafts and radii of a run that is being made, measured here."""
    return View(follow=_Measuring(run).draw, overviews=_OVERVIEWS, needs=_is_final)


def _is_final(line: FrameLine) -> bool:
    return line.role == NeedleRole.FINAL


class _Measuring:
    """Measures pictures as they come."""

    def __init__(self, run: Run) -> None:
        protocol = load_recorded_protocol(run.protocol_path, {"steerability": SteerabilityProtocol})
        assert isinstance(protocol, SteerabilityProtocol)
        self._run = run
        self._plane = load_plane_map(run)
        self._settings = make_settings(protocol)
        self._mask = load_mask_of_run(run)
        self._gels = [gel.name for gel in protocol.specimens]
        self._by_trial: dict[int | None, str] = {}

    def draw(self, stream: rr.RecordingStream, _timeline: str, lines: RecordLines) -> None:
        """Measure the pictures of the needle, and draw shaft and radius."""
        for event in parse_events(self._run.path, lines.events, (SpecimenTrialStart,)):
            self._by_trial[event.trial] = event.specimen
        for picture in lines.pictures:
            set_time(stream, picture.line.t_s)
            draw_shaft(stream, self._measure(stream, picture) if picture.line.role in MEASURED_ROLES else [])

    def _measure(self, stream: rr.RecordingStream, picture: RecordedPicture) -> list[FloatArray]:
        """Draw the radius of a final picture, and return the centre line in pixels."""
        line, measured = picture.line, measure_picture(picture, self._plane, self._settings, self._mask)
        if _is_final(line) and measured.accepted and measured.radius_mm is not None:
            _draw_radius(stream, self._gels, self._by_trial[line.trial], measured.radius_mm)
        return [] if measured.line is None else [measured.line.px]
