"""Conditions of a protocol that a run meets: it pauses, or it stops, and a resumed run knows of it."""

from pathlib import Path

import pytest

from labrig.analysis.pictures import load_plane_map, measure_picture
from labrig.errors import ConditionMetError
from labrig.experiments.registry import load_run_protocol
from labrig.experiments.shared.curvature import make_settings
from labrig.experiments.shared.needle_events import SpecimenTrialStart, SpecimenTrialStop
from labrig.experiments.steerability.protocol import SteerabilityProtocol
from labrig.record.events import ConditionMet, Pause, ValueMeasured
from labrig.report.event_words import list_decisions
from labrig.runner.past import read_past
from tests.runner.sessions import bench, sweep
from tests.runner.test_pausing import GO_ON, SHORT, SPARSE, make_run, require_identical

LOOSE = ("analysis.max_radius_sigma_mm=900", "insertion.length_mm=22", "insertion.frame_every_mm=20")


def test_a_condition_pauses_the_run_and_tells_value_and_condition(tmp_path: Path) -> None:
    """The radius is that of the analysis; the run asks after each insertion, goes on, and replays identically."""
    text = "radius_mm above 1"
    outcome, run, person, _ = make_run(
        tmp_path,
        [GO_ON, GO_ON, GO_ON],
        overrides=(*LOOSE, "conditions=[{value: radius_mm, above: 1}]", "hole_order=random"),
    )
    assert outcome.exit_status == "success"
    values = run.read_events(ValueMeasured)
    protocol = load_run_protocol(run)
    assert isinstance(protocol, SteerabilityProtocol)
    for value, trial in zip(values, run.read_trials(SpecimenTrialStart, SpecimenTrialStop), strict=True):
        assert trial.stop is not None
        assert trial.stop.final_frame is not None
        picture = run.pictures.places[trial.stop.final_frame]
        found = measure_picture(picture, load_plane_map(run), make_settings(protocol), None)
        assert (value.trial, value.value) == (trial.start.trial, pytest.approx(found.radius_mm, rel=1e-12))
    met, pause = run.read_events(ConditionMet)[0], run.read_events(Pause)[0]
    assert [event.trial for event in run.read_events(ConditionMet)] == [value.trial for value in values]
    assert (met.trial, met.action, met.condition, met.value) == (0, "ask", text, values[0].value)
    assert (pause.by, pause.point) == ("condition", "trial_end")
    told = f"radius_mm of trial 1 is {met.value:.4g} (ask when {text})"
    assert any(f"Paused after this insertion, because {told}" in asked for asked in person.asked)
    assert any(text in sentence for _, sentence in list_decisions(run))
    require_identical(run)


def test_a_condition_stops_the_run_and_a_resumed_one_goes_on(tmp_path: Path) -> None:
    """The run ends as a person stops it, the answer is no; resumed, it stops for the next value that meets it."""
    protocol = sweep(*SHORT, *LOOSE, "conditions=[{value: radius_mm, above: 1, do: stop}]")
    with bench(tmp_path, protocol, SPARSE) as at:
        outcome, run = at.conduct(protocol)
        assert isinstance(outcome.error, ConditionMetError)
        assert (outcome.exit_status, outcome.error.exit_code) == ("aborted", 1)
        assert "(stop when radius_mm above 1)" in outcome.reason
        require_identical(run)
        assert read_past(run).kept == 1
        again, run = at.resume(run, anew=False)
    assert "radius_mm of trial 2 is" in again.reason
    assert [len(run.read_events(kind)) for kind in (ValueMeasured, ConditionMet)] == [2, 2]
