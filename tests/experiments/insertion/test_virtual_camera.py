"""What a virtual insertion sees."""

from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from labrig.devices.rig_file import load_rig
from labrig.experiments.insertion.virtual_camera import CalibratedCamera, SightingErrors
from labrig.experiments.shared.rig_view import load_plane_map
from labrig.simulation.world import World

RIG = load_rig(Path(__file__).parents[3] / "calibration" / "rig-simulated.yaml")
EXACT = SightingErrors(**{field.name: 0.0 for field in fields(SightingErrors)})


def insert(length_mm: float, errors: SightingErrors, seed: int = 1) -> tuple[World, CalibratedCamera]:
    """Return a world with a needle inserted by so much, and a camera with these errors."""
    assert RIG.world is not None
    world = World(RIG.world, seed)
    world.mount_needle("N1")
    world.place_phantom("phantom", 13.0, [])
    world.advance(length_mm, 0.0, 15.0)
    camera = CalibratedCamera(
        RIG.world.lens, load_plane_map(RIG), np.random.default_rng(seed), replace(errors, correlated_mm=4.0)
    )
    return world, camera


def test_a_tip_is_read_by_the_rigs_own_map() -> None:
    """Without further errors it is off by what the calibration is off there, at most tenths of a millimetre."""
    world, camera = insert(30.0, EXACT)
    seen_mm, tip_mm = camera.see_tip(world, 0.0), np.array(world.tip_mm())
    assert seen_mm is not None
    assert seen_mm[0] == 0.0
    assert 0.001 < np.linalg.norm(seen_mm[1:] - tip_mm[1:]) < 0.3


def test_a_straight_tip_is_read_off_to_the_side_to_which_its_template_bends() -> None:
    """The template has the bend of the commanded side: turned over, it reads the other way."""
    world, camera = insert(30.0, replace(EXACT, side_mm=0.05))
    sides = [camera.see_tip(world, base_rad) for base_rad in (0.0, np.pi)]
    first, second = (side for side in sides if side is not None)
    assert np.linalg.norm(first - second) == pytest.approx(0.1)


def test_a_tip_at_the_rim_or_behind_the_sheath_is_not_found() -> None:
    """Neither a needle that has left the picture nor one that has not left the sheath is seen."""
    far, camera = insert(87.0, EXACT)
    assert camera.see_tip(far, 0.0) is None
    hidden, camera = insert(0.5, replace(EXACT, hidden_mm=1.0, hidden_share=1.0))
    assert camera.see_tip(hidden, 0.0) is None
