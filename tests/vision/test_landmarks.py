"""What a camera's view draws over a picture: the sheath where it is."""

import numpy as np
import pytest

from labrig.errors import InputError
from labrig.simulation.world import World
from labrig.vision.calibration_file import load_intrinsics, load_plane
from labrig.vision.drawing import find_landmarks
from labrig.vision.plane import PlaneMap
from tests.devices.rigs import CALIBRATION, large_rig


@pytest.fixture
def world() -> World:
    """A simulated bench, without noise."""
    described = large_rig().world
    assert described is not None
    return World(described, seed=1)


def _load_plane() -> PlaneMap:
    lens = load_intrinsics(CALIBRATION / "simulated-intrinsics.json")
    return load_plane(CALIBRATION / "simulated-plane.json", lens)


def test_the_sheath_is_drawn_to_its_tip(world: World) -> None:
    """A line of 10 mm leads to the tip, another across it is as long as the sheath is wide."""
    world.mount_needle("N1")
    world.place_specimen("gel", 13.0)
    world.shift_to_hole("gel", 0, 0.0)
    world.advance(0.0, 0.0, 15.0)
    (sheath,) = find_landmarks(world.picture(), _load_plane, 2.0)
    assert sheath.found
    along, across = (np.array(line) for line in sheath.lines)
    truly = _load_plane().to_px(np.array([world.truth()["sheath_tip_mm"]]))[0]
    assert along[1] == pytest.approx(truly, abs=1.0)
    px_per_mm = 1.0 / _load_plane().mm_per_px
    assert np.linalg.norm(np.diff(along, axis=0)) == pytest.approx(10.0 * px_per_mm, rel=0.05)
    assert np.linalg.norm(np.diff(across, axis=0)) == pytest.approx(2.2 * px_per_mm, rel=0.1)


def test_a_missing_plane_is_the_reason(world: World) -> None:
    """Without a usable plane map the sheath is not searched, and it is said why."""

    def refuse() -> PlaneMap:
        raise InputError("the plane is of another focus")

    (sheath,) = find_landmarks(world.picture(), refuse, 2.0)
    assert (sheath.found, sheath.text) == (False, "the plane is of another focus")
