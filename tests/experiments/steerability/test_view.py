"""A sweep in the rerun viewer."""

from pathlib import Path

import pytest

from labrig.analysis.result import NO_LINES
from labrig.analysis.run import analyze_run
from labrig.devices.cia402_states import describe_statusword
from labrig.experiments.registry import find_run_experiment, follow_run, make_run_view
from labrig.record.reader import open_run
from labrig.report.rerun_view import write_view
from tests.analysis.synthetic import NOW, PROVENANCE, SyntheticSweep, record_sweep
from tests.rerun_files import read_view


def test_radii_that_are_measured_live_are_those_of_the_result(tmp_path: Path) -> None:
    """Hole by hole, mean and interval of a gel grow to what the analysis finds; a refused picture adds nothing."""
    run = record_sweep(tmp_path, SyntheticSweep(without_needle=frozenset({3})))
    live = read_view(write_view(run, NO_LINES, follow_run(run), describe_statusword))
    result = analyze_run(run, find_run_experiment(run), workers=1, created=NOW, provenance=PROVENANCE)
    run = open_run(run.path)
    measured = read_view(write_view(run, NO_LINES, make_run_view(run), describe_statusword))
    gels = [place for place in measured if place.startswith("/radii/")]
    assert {place: live[place] for place in gels} == {place: measured[place] for place in gels}
    means = [group["mean_radius_mm"] for group in result.document["specimens"]]
    assert [live[f"/radii/gel {name}/mean"][-1] for name in "AB"] == pytest.approx(means)
    assert [len(live[f"/radii/gel {name}/hole"]) for name in "AB"] == [2, 1]
    assert "refused: " in live["/gels"][-1]
    assert "/camera/shaft" in live
