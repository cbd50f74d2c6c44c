"""A sweep in the rerun viewer."""

from pathlib import Path

import pytest

from labrig.analysis.run import analyze_run
from labrig.devices.drives.states import describe_statusword
from labrig.experiments.registry import find_run_experiment, follow_run, make_run_view
from labrig.record.events import MarkBad
from labrig.record.reader import open_run
from labrig.record.writer import reopen_run
from labrig.report.rerun_view import write_view
from tests.analysis.synthetic import NOW, PROVENANCE, SyntheticSweep, record_sweep
from tests.rerun_files import read_view


def test_radii_that_are_measured_live_are_those_of_the_result(tmp_path: Path) -> None:
    """Each hole has the radius that the analysis finds, without refused pictures and bad holes."""
    radii_mm = {"gel A": (28.0, 28.6, 40.0), "gel B": (27.0, 27.4)}
    sweep = SyntheticSweep(radii_mm=radii_mm, without_needle=frozenset({4}), exit_status="aborted")
    path = record_sweep(tmp_path, sweep).path
    recorder = reopen_run(path, "test")
    recorder.record_event(MarkBad(trial=2, reason="the needle was bent"), 0.0)
    recorder.close("success", "", NOW)
    run = open_run(path)
    live = read_view(write_view(run, {}, follow_run(run), describe_statusword))
    result = analyze_run(run, find_run_experiment(run), workers=1, created=NOW, provenance=PROVENANCE)
    run = open_run(run.path)
    measured = read_view(write_view(run, {}, make_run_view(run), describe_statusword))
    of_gel_b = [place for place in measured if place.startswith("/radii/gel B")]
    assert {place: live[place] for place in of_gel_b} == {place: measured[place] for place in of_gel_b}
    finals = [seen["radius_mm"] for seen in result.document["measurements"] if seen["role"] == "final"]
    kept = [radius_mm for radius_mm in finals if radius_mm is not None]
    assert measured["/radii/gel A"] == pytest.approx(kept[:2])
    # It was drawn before it was marked.
    assert [len(shown["/radii/gel A"]) for shown in (live, measured)] == [3, 2]
    assert "/camera/shaft" in live
