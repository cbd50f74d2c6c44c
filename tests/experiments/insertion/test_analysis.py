"""The analysis of an insertion run: errors by the shaft, and estimates from the recorded pictures."""

import shutil
from pathlib import Path

import pytest

from labrig.errors import InputError
from labrig.record.reader import open_run
from tests.experiments.insertion.recorded import analyse_recorded, observations, record_insertion
from tests.experiments.insertion.test_procedure import EVEN, analyse, conduct_insertion, insertion, truth


def test_the_error_is_measured_by_the_shaft_near_what_is_true() -> None:
    """The measured error is within 0.3 mm of the true one, under the keys of the interface."""
    content = analyse_recorded()
    assert content.reached
    assert content.target_error_mm is not None
    assert content.true_target_error_mm is not None
    assert content.target_error_mm == pytest.approx(content.true_target_error_mm, abs=0.3)
    assert content.true_min_clearance_mm is not None
    assert content.true_min_clearance_mm > 0
    assert content.length_mm == pytest.approx(41, abs=2)
    assert content.insertions[0].shaft_mm
    assert (content.made, content.arrived, content.causes) == (1, 1, {})


def test_estimated_again_everything_comes_out_as_it_was() -> None:
    """With the protocol's settings, recorded pictures and turns give every live estimate again."""
    run = record_insertion()
    steps = analyse_recorded().insertions[0].steps
    live = observations(run)
    assert len(steps) == len(live) > 30
    for again, was in zip(steps, live, strict=True):
        assert again.estimate_mm == pytest.approx(was["estimate_mm"], abs=1e-9)
        assert again.heading_rad == pytest.approx(was["heading_rad"], abs=1e-9)
        assert again.nis == pytest.approx(was["nis"], abs=1e-6)


def test_other_settings_of_the_estimator_tell_what_would_have_been(tmp_path: Path) -> None:
    """Another observation noise changes the estimates, not the measured end of the needle."""
    run = open_run(shutil.copytree(record_insertion().path, tmp_path / "run"))
    was, would_be = analyse_recorded(), analyse(run, "estimator.observation_sd_mm=0.2")
    assert would_be.insertions[0].mean_nis != was.insertions[0].mean_nis
    assert would_be.target_error_mm == was.target_error_mm
    assert would_be.overrides == ("estimator.observation_sd_mm=0.2",)
    with pytest.raises(InputError, match=r"estimator\.\*"):
        analyse(run, "target.tolerance_mm=5")


def test_truth_is_compared_where_there_is_one(tmp_path: Path) -> None:
    """Within half a millimetre all the way, of a needle that slips by 3 mm too; unknown without truth or picture."""
    slips = (*EVEN, "world.disturbances.slip_sd_fraction=0.05")
    run = open_run(conduct_insertion(tmp_path, insertion("specimen.name=wet"), slips)[1].path)
    assert run.states["insertion_mm"].max() - truth(run)["arc_length_mm"] > 3
    for step in analyse(run).insertions[0].steps:
        assert step.true_mm is not None
        assert step.estimate_mm == pytest.approx(step.true_mm, abs=0.5)
    copy = shutil.copytree(run.path, tmp_path / "real")
    (copy / "truth.jsonl").unlink()
    final = run.frame_table.loc[run.frame_table["role"] == "final", "file"].iloc[0]
    (copy / final).write_bytes(b"no picture")
    content = analyse(open_run(copy))
    assert (content.true_target_error_mm, content.target_error_mm) == (None, None)
    assert content.insertions[0].steps[-1].true_mm is None
    assert content.insertions[0].unmeasured


def test_insertions_that_missed_are_counted_with_their_causes() -> None:
    """Successful repetitions are counted, and the others by cause."""
    near = ("target.position_mm=[0,-2,20]", "obstacles=[]")
    content = analyse_recorded("repetitions=2", "target.tolerance_mm=0.001", *near)
    assert (content.made, content.arrived, content.reached) == (2, 0, False)
    assert content.causes == {"target_missed": 2}
    assert content.target_error_mm == max(insertion.target_error_mm or 0 for insertion in content.insertions)


def test_the_sightings_of_a_record_tell_their_noise() -> None:
    """The tip is seen to a few hundredths of a millimetre, and less than a template's bias is not advised."""
    noise = analyse_recorded().sighting_noise
    assert noise is not None
    assert noise.observation_sd_mm is not None
    assert 0.003 < noise.observation_sd_mm < 0.05
    assert noise.advised_observation_sd_mm == 0.05
    assert noise.stated_observation_sd_mm == 0.05
