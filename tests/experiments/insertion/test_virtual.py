"""Virtual insertions: the steering loop against the simulated world, without pictures."""

import hashlib
import pickle
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from labrig.analysis.outcome import TaskOutcome
from labrig.devices.rig_file import RigDescription, load_rig
from labrig.errors import InputError
from labrig.experiments.declared import PROTOCOL_MODELS
from labrig.experiments.registry import find_experiment
from labrig.protocol.load import load_protocol
from labrig.protocol.sections import ExperimentProtocol

ROOT = Path(__file__).parents[3]


def protocol(*settings: str) -> ExperimentProtocol:
    """Return the example protocol with settings."""
    model: Any = load_protocol(ROOT / "protocols" / "insertion.yaml", PROTOCOL_MODELS, list(settings))
    assert isinstance(model, ExperimentProtocol)
    return model


@cache
def simulated_rig(*settings: str) -> RigDescription:
    """Return the simulated rig with settings."""
    return load_rig(ROOT / "calibration" / "rig-simulated.yaml", list(settings))


def simulate(*settings: str, seed: int = 1, world: tuple[str, ...] = ()) -> TaskOutcome:
    """Return what comes of a virtual insertion."""
    return find_experiment("insertion").simulate(protocol(*settings), simulated_rig(*world), seed)


def digest_outcomes(outcomes: Sequence[TaskOutcome]) -> str:
    """Return the digest of outcomes, their numbers to a millionth: what differs by more was decided otherwise."""
    rounded = [
        (
            outcome.exit_status,
            outcome.reason,
            {
                name: round(value, 6) if isinstance(value, float) else value
                for name, value in outcome.values.items()
            },
        )
        for outcome in outcomes
    ]
    return hashlib.sha256(repr(rounded).encode()).hexdigest()[:16]


def test_a_seed_gives_the_same_insertion_again_and_another_seed_another() -> None:
    """The outcome is the same to the last bit, and survives pickling, as a pool of processes needs it."""
    first, again, other = simulate(), simulate(), simulate(seed=2)
    assert (first.exit_status, first.reason, first.values["reached"]) == ("success", None, True)
    assert first == again == pickle.loads(pickle.dumps(first))
    assert first.values != other.values


def test_a_target_behind_a_wall_is_a_failure_with_the_reason_of_a_run() -> None:
    """No path is no error: the outcome says so, and none of its values is a number."""
    wall = "obstacles=[{position_mm: [0, 0, 40], radius_mm: 30}]"
    outcome = simulate(wall, "planner.max_arcs=2")
    assert (outcome.exit_status, outcome.reason) == ("failed", "no_path")
    assert set(outcome.values.values()) == {None}
    assert outcome.values.keys() == simulate().values.keys()


def test_what_takes_pictures_is_refused_with_the_way_out() -> None:
    """Markers, and a bench without a simulated world, are refused."""
    marked = ("target.marker_id=7", "markers={side_mm: 6}")
    with pytest.raises(InputError, match="markers are followed in pictures"):
        simulate(*marked)
    with pytest.raises(InputError, match="world of a simulated rig"):
        find_experiment("insertion").simulate(protocol(), None, 1)


EVERY_20_MM = ("policy.deviation_mm=null", "policy.near_mm=0", "policy.final_mm=0")


@pytest.mark.parametrize(
    ("world", "settings", "digest"),
    [
        ("simulated", (), "4f392b09d14319c3"),
        ("simulated", EVERY_20_MM, "4000fcb4323777cd"),
        ("hard", ("recovery={}",), "c5beb422a07dba7c"),
    ],
)
def test_decisions_stay_the_same(world: str, settings: tuple[str, ...], digest: str) -> None:
    """A faster planner, estimator or world ends every insertion where it ended before."""
    rig = load_rig(ROOT / "calibration" / f"rig-{world}.yaml")
    outcomes = [find_experiment("insertion").simulate(protocol(*settings), rig, seed) for seed in (1, 2)]
    assert digest_outcomes(outcomes) == digest
