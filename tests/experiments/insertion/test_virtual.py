"""Virtual insertions: the steering loop against the simulated world, without pictures."""

import pickle
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from labrig.analysis.experiment import TaskOutcome
from labrig.devices.rig_file import RigDescription, load_rig
from labrig.errors import InputError
from labrig.experiments.declared import PROTOCOL_MODELS
from labrig.experiments.registry import find_experiment
from labrig.protocol.load import load_protocol
from labrig.protocol.sections import ExperimentProtocol
from labrig.runner.dry_run import simulate as run_simulation

ROOT = Path(__file__).parents[3]


def protocol(*settings: str) -> ExperimentProtocol:
    """Return the example protocol with settings."""
    model: Any = load_protocol(ROOT / "protocols" / "insertion.yaml", PROTOCOL_MODELS, list(settings))
    assert isinstance(model, ExperimentProtocol)
    return model


@cache
def large_rig(*settings: str) -> RigDescription:
    """Return the simulated rig with settings."""
    return load_rig(ROOT / "calibration" / "rig-simulated.yaml", list(settings))


def simulate(*settings: str, seed: int = 1, world: tuple[str, ...] = ()) -> TaskOutcome:
    """Return what comes of a virtual insertion."""
    return run_simulation(find_experiment("insertion"), protocol(*settings), large_rig(*world), seed)


def test_a_seed_gives_the_same_insertion_again_and_another_seed_another() -> None:
    """The outcome is the same to the last bit, and survives pickling, as a pool of processes needs it."""
    first, again, other = simulate(), simulate(), simulate(seed=2)
    assert (first.exit_status, first.reason, first.values["reached"]) == ("success", None, True)
    assert first == again == pickle.loads(pickle.dumps(first))
    assert first.values != other.values


def test_no_path_is_an_outcome_and_a_bench_without_a_world_is_refused() -> None:
    """The outcome has the reason of a run, and no values."""
    outcome = simulate("obstacles=[{position_mm: [0, 0, 40], radius_mm: 30}]", "planner.max_arcs=2")
    assert (outcome.exit_status, outcome.reason, outcome.values) == ("failed", "no_path", {})
    with pytest.raises(InputError, match="in the world of a simulated rig"):
        run_simulation(find_experiment("insertion"), protocol(), None, 1)
