"""What an insertion would have been told with other settings, over the sightings that were recorded."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from labrig.analysis import insertion_settings, steer_again
from labrig.errors import RecordError
from labrig.protocol import InsertionProtocol, dump_yaml, load_protocol
from labrig.record import Recorder, Run, open_run
from labrig.steering import TipSighting, start_steering, step_steering
from tests.record.runs import ENDED, STARTED

ROOT = Path(__file__).parents[2]
TARGET_MM = (0.0, 4.0, 60.0)


def _protocol(*overrides: str) -> InsertionProtocol:
    protocol = load_protocol(ROOT / "protocols" / "insertion.yaml", ["obstacles=[]", *overrides])
    assert isinstance(protocol, InsertionProtocol)
    return protocol


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """An insertion whose tip is seen where it is predicted, but for a little noise; its record alone, no pictures."""
    protocol, draw = _protocol(), np.random.default_rng(6)
    recorder = Recorder.create(
        tmp_path_factory.mktemp("runs"), "run", {"experiment": "insertion", "started": STARTED},
        dump_yaml(protocol), None, {},
    )  # fmt: skip
    recorder.event("trial_start", 0.0, trial=0, target_mm=TARGET_MM, tolerance_mm=2.0, obstacles=[])
    settings = insertion_settings(protocol, TARGET_MM, ())
    state, command = start_steering(settings)
    number = 0
    while command.stop is None:
        depth_mm = command.observe_at_mm
        y_mm, z_mm = state.predicted(depth_mm, settings)[1:3, 3] + draw.normal(0.0, 0.2, 2)
        seen = None if number % 9 == 4 else (0.0, float(y_mm), float(z_mm))
        state, command = step_steering(
            state, TipSighting(depth_mm, None if seen is None else np.asarray(seen)), settings
        )
        said = {"tip_mm": seen, "estimate": {"position_mm": state.tip.position_mm.tolist()}}
        depth_mm = state.insertion_mm
        recorder.event("observation", 1.0 + number, trial=0, frame=number, depth_mm=depth_mm, **said)
        number += 1
    recorder.close("success", "", ENDED)
    return open_run(recorder.path)


def test_unchanged_settings_give_every_command_again(run: Run) -> None:
    """The estimates are those of the record to the last digit, and no command differs."""
    (found,) = steer_again(run, _protocol())
    assert (found.as_recorded, found.divergence) == (True, None)
    assert found.old == found.new
    assert found.sightings > 20
    assert found.old.turns == len(found.old.turns_at_mm) > 0


def test_the_first_command_that_differs_is_named(run: Run) -> None:
    """A radius that the planner believes otherwise shows in the first command, before anything was seen."""
    (found,) = steer_again(run, _protocol("planner.radius_mm=33"))
    assert found.as_recorded
    assert found.divergence is not None
    assert found.divergence.old != found.divergence.new
    assert found.divergence.frame is None or found.divergence.frame >= 0


def test_an_estimator_of_another_kind_parts_later(run: Run) -> None:
    """Other estimates lead to another command, if at all, after some picture; what was recorded stays as it was."""
    (found,) = steer_again(run, _protocol("estimator.observation_sd_mm=2.0"))
    assert found.as_recorded
    assert found.old.tip_mm != found.new.tip_mm
    if found.divergence is not None:
        assert found.divergence.depth_mm > 0.0


def test_a_run_that_is_no_insertion_is_refused(tmp_path: Path) -> None:
    """Steering is asked of insertions alone."""
    copy = Path(shutil.copytree(ROOT / "data" / "first-record", tmp_path / "run"))
    with pytest.raises(RecordError, match="is no insertion"):
        steer_again(open_run(copy), _protocol())
