"""A simulated rig in the place of a bench, in whose world the protocol of an insertion is right."""

import math
from pathlib import Path

import numpy as np
import pytest

from labrig.devices.needle_state import RollZero
from labrig.devices.rig_file import RigDescription, load_rig
from labrig.errors import InputError
from labrig.experiments.insertion.protocol import InsertionProtocol
from labrig.experiments.insertion.virtual import simulate
from labrig.experiments.insertion.virtual_bench import fit_lens, make_assumed_rig
from labrig.experiments.shared.rig_view import load_plane_map
from labrig.simulation.lens import plane_to_pixels
from labrig.vision.plane import Insertion, PlaneMap
from tests.experiments.insertion.test_procedure import insertion

ROOT = Path(__file__).parents[3]
SIZE_PX = (1280, 720)
ROLL_ZERO = RollZero("N1", 1.3, 0.01, "before")


def bench(**changes: object) -> RigDescription:
    """Return a bench with the calibration of the simulated rig."""
    rig = load_rig(ROOT / "calibration" / "rig-simulated.yaml")
    changed = rig.model_copy(update={"kind": "bench", "world": None, "state_file": "state.json", **changes})
    return changed.placed_in(rig.folder)


def protocol(*overrides: str) -> InsertionProtocol:
    """Return a short insertion."""
    found = insertion("target.position_mm=[0,-2,15]", "insertion.frame_every_mm=5", *overrides)
    assert isinstance(found, InsertionProtocol)
    return found


def test_the_world_is_what_the_protocol_assumes_and_its_needle_arrives() -> None:
    """Radius, hinges, wandering and roll zero are the protocol's and the run's; the simulated needle gets there."""
    assumed = make_assumed_rig(protocol(), bench(), ROLL_ZERO)
    world = assumed.rig.world
    assert world is not None
    assert [gel.radius_mean_mm for gel in world.gels] == [27.7]
    assert (world.needle.backlash_mm, world.needle.hinge_closing_mm) == (1.5, 3.0)
    assert world.needle.clamp_roll_deg == pytest.approx(-math.degrees(1.3))
    assert world.disturbances.out_of_plane_deg_per_root_mm == 0.05
    assert "made on a bench" in assumed.note
    for seed in range(3):
        outcome = simulate(protocol(), assumed.rig, seed, ROLL_ZERO)
        error_mm = outcome.values["true_target_error_mm"]
        assert isinstance(error_mm, float)
        assert error_mm < 1.0


@pytest.mark.parametrize("direction", ["right", "left", "up", "down"])
def test_the_world_sees_the_plane_as_the_map_does_from_every_side(direction: Insertion) -> None:
    """Also with a map that knows no lens, whichever way the insertion goes in the picture."""
    plane = PlaneMap.from_scale(9.7, (600.0, 300.0), direction, SIZE_PX)
    fitted = fit_lens(plane, SIZE_PX)
    assert fitted.worst_mm < 0.01
    places_mm = np.array([(0.0, 0.0), (3.0, 20.0), (-8.0, 5.0)])
    np.testing.assert_allclose(plane_to_pixels(places_mm, fitted.lens), plane.to_px(places_mm), atol=0.1)
    assert fit_lens(load_plane_map(bench()), SIZE_PX).worst_mm < 0.01


def test_a_bench_that_no_pinhole_sees_alike_is_refused() -> None:
    """A map that shears the plane is no camera's: the limit is named."""
    plane = load_plane_map(bench())
    sheared = plane.homography @ np.array([[1.0, 0.3, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    assert (
        fit_lens(
            PlaneMap(sheared, plane.intrinsics, plane.origin_px, "right", SIZE_PX, 0.1), SIZE_PX
        ).worst_mm
        > 0.5
    )
    uncalibrated = bench(calibration=bench().calibration.model_copy(update={"plane": None}))
    with pytest.raises(InputError, match="names no plane"):
        make_assumed_rig(protocol(), uncalibrated, ROLL_ZERO)
