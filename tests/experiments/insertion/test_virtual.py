"""Virtual insertions: the steering loop against the simulated world, without pictures."""

import pickle

import numpy as np
import pytest

from labrig.analysis.experiment import TaskOutcome
from labrig.devices.axis_positions import AxisPositions
from labrig.errors import InputError
from labrig.experiments.declared import PROTOCOL_MODELS, find_experiment
from labrig.protocol.load import load_protocol
from labrig.protocol.sections import Sheath
from labrig.runner.dry_run import simulate as run_simulation
from labrig.runner.sight import TakenPicture
from labrig.runner.virtual_rig import VirtualPhotograph
from labrig.runner.virtual_sight import WorldSight
from labrig.simulation.description import LayerDescription, SheathDescription
from labrig.simulation.world import World
from labrig.vision.plane import PlaneMap
from tests.benchmarks.virtual import end_wandering
from tests.devices.rigs import large_rig
from tests.runner.sessions import PROTOCOLS, sweep


def simulate(*settings: str, seed: int = 1, **changed: object) -> TaskOutcome:
    """Return what comes of a virtual insertion, in a world with changes."""
    protocol, rig = load_protocol(PROTOCOLS / "insertion.yaml", PROTOCOL_MODELS, settings), large_rig()
    assert rig.world is not None
    rig = rig.model_copy(update={"world": rig.world.model_copy(update=changed)})
    return run_simulation(find_experiment("insertion"), protocol, rig, seed)


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
        run_simulation(find_experiment("steerability"), sweep(), None, 1)


def test_a_needle_that_stays_in_its_sheath_has_no_values() -> None:
    """A sheath far aside of the plane looks longer than it is: the run stops before the needle leaves it."""
    outcome = simulate(seed=22, sheath=SheathDescription(x_play_sd_mm=1.5))
    assert (outcome.exit_status, outcome.values) == ("failed", {})
    assert outcome.reason == "sheath_astray"


def test_a_gel_in_layers_is_steered_through() -> None:
    """The curvature has no noise of its own: the heading follows radii of 0.7 and 1.3 times the expected one."""
    layers = [LayerDescription(until_mm=end, radius_scale=scale) for end, scale in ((40, 0.7), (80, 1.3))]
    outcome = simulate(layers=tuple(layers))
    error_mm = outcome.values["true_target_error_mm"]
    assert outcome.exit_status == "success"
    assert isinstance(error_mm, float)
    assert error_mm < 0.5


def test_what_is_read_off_a_picture_grows_with_the_mm_of_a_pixel() -> None:
    """A camera that shows half as many pixels of a mm is off by twice as much, with the same noise."""
    described = large_rig().world
    assert described is not None
    world, sheath = World(described, 1), Sheath(depth_mm=15.0, speed_mm_s=5.0, diameter_mm=2.0)
    glance, stance = world.glance(), AxisPositions(0.0, 0.0, 15.0)
    taken = TakenPicture(0, VirtualPhotograph(np.zeros((1, 1), np.uint8), 0.0, stance, glance=glance))
    off_mm = []
    for px_per_mm in (10.0, 5.0):
        plane = PlaneMap.from_scale(px_per_mm, (320.0, 200.0), "right")
        found = WorldSight(world, plane, np.random.default_rng(1), None).find_sheath(taken, sheath, 0)
        assert found.tip_mm is not None
        off_mm.append(np.array(found.tip_mm) - glance.sheath_mm[0][1:])
    assert off_mm[1] == pytest.approx(2 * off_mm[0])
    assert np.linalg.norm(off_mm[0]) > 0


def test_a_needle_that_wanders_more_than_told_is_seldom_a_false_success() -> None:
    """Of whole insertions that wander six times as much as told and end beyond, at most a tenth says success."""
    ends = [end_wandering(0.3, seed) for seed in range(741_000, 741_008)]
    said = [success for success, beyond in ends if beyond]
    assert len(said) >= 4
    assert sum(said) <= 0.1 * len(said)
