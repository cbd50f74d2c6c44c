"""Computes the result from the pictures; imports nothing that moves a motor."""

import math

import numpy as np

from labrig.analysis.experiment import AnalysisRequest
from labrig.analysis.result import Findings
from labrig.record.reader import Run
from labrig.vision.picture import as_grey
from labrig_example.repeatability.events import VisitStart, VisitStop
from labrig_example.repeatability.protocol import RepeatabilityProtocol
from labrig_example.repeatability.result import RepeatabilityResult, Visit


def analyze(run: Run, protocol: RepeatabilityProtocol, request: AnalysisRequest) -> Findings:
    """Find the marker in the picture of each visit that is to be evaluated, and the spread of its positions.

    Raises
    ------
    RecordError
        When lines or pictures of the run are damaged.
    """
    settings = protocol.analysis
    visits = tuple(
        _find_marker(run, trial.start.trial, trial.stop.final_frame, settings.threshold)
        for trial in run.read_trials(VisitStart, VisitStop)
        if trial.stop is not None and not trial.left_out
    )
    places = [
        (visit.u_px, visit.v_px) for visit in visits if visit.u_px is not None and visit.v_px is not None
    ]
    spread_px = max((math.dist(places[0], place) for place in places), default=None)
    result = RepeatabilityResult(
        **request.stamp.fields(settings.model_dump()),
        accepted=spread_px is not None and spread_px <= settings.max_spread_px,
        spread_px=spread_px,
        visits=visits,
    )
    return Findings(result)


def _find_marker(run: Run, trial: int, frame: int, threshold: int) -> Visit:
    """Return the centre of the pixels that are as bright as the marker."""
    v_px, u_px = np.nonzero(as_grey(run.read_frame(frame)) >= threshold)
    if u_px.size == 0:
        return Visit(trial=trial, frame=frame)
    return Visit(trial=trial, frame=frame, u_px=float(u_px.mean()), v_px=float(v_px.mean()))
