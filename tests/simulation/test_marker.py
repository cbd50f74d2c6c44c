"""Printed markers in the simulated picture: where the lens sees them, and how they move with the target."""

import numpy as np
import pytest

from labrig.errors import InputError
from labrig.simulation.description import PrintedMarkerDescription, WorldDescription
from labrig.simulation.lens import plane_to_pixels, see_points
from labrig.simulation.world import World
from tests.simulation.benches import QUIET, insert

MARKER = PrintedMarkerDescription(marker_id=7, side_mm=6.0, position_mm=(-12.0, 25.0), turn_deg=30.0)


def world(*markers: PrintedMarkerDescription, target_moves_mm: float = 0.0) -> World:
    """Return a world with a phantom whose target is known."""
    description = WorldDescription(**{**dict(QUIET), "markers": markers, "target_moves_mm": target_moves_mm})
    made = World(description, 5)
    made.mount_needle("N1")
    made.place_phantom("A", 13.0, ())
    made.aim_at((0.0, 0.0, 60.0))
    return made


def find_ink(shown: World, inserted_mm: float = 0.0) -> np.ndarray | None:
    """Return the middle (u, v) of what is darker than in a world without markers; None if nothing is."""
    bare = World(shown.description.model_copy(update={"markers": ()}), 5)
    bare.mount_needle("N1")
    bare.place_phantom("A", 13.0, ())
    if inserted_mm:
        insert(bare, inserted_mm)
    inked = bare.picture().astype(int) - shown.picture() > 60
    if not inked.any():
        return None
    v, u = np.nonzero(inked)
    return np.array([u.min() + u.max(), v.min() + v.max()]) / 2


@pytest.mark.parametrize("x_mm", [0.0, -15.0])
def test_a_marker_is_drawn_where_the_lens_sees_it(x_mm: float) -> None:
    """The middle of its ink is where its centre's line of sight ends, in the plane and before it."""
    shown = world(MARKER.model_copy(update={"x_mm": x_mm}))
    seen, _ = see_points(np.array([(x_mm, *MARKER.position_mm)]), shown.description.lens)
    assert find_ink(shown) == pytest.approx(plane_to_pixels(seen, shown.description.lens)[0], abs=1.0)


def test_a_marker_moves_with_the_target_and_is_covered_where_it_is_said_to_be() -> None:
    """Target and marker are displaced by as much; while it is covered there is no marker."""
    shown = world(MARKER.model_copy(update={"covered_mm": (20.0, 90.0)}), target_moves_mm=15.0)
    insert(shown, 12.0)
    target_mm = shown.locate_target_mm()
    assert target_mm is not None
    displaced_mm = np.array(target_mm[1:]) - (0.0, 60.0)
    assert np.linalg.norm(displaced_mm) == pytest.approx(3.0, abs=0.01)
    px = plane_to_pixels(np.array([displaced_mm + MARKER.position_mm]), shown.description.lens)[0]
    assert find_ink(shown, 12.0) == pytest.approx(px, abs=1.0)
    insert(shown, 25.0)
    assert find_ink(shown, 25.0) is None


def test_a_marker_that_its_dictionary_lacks_is_refused() -> None:
    """The world names it when it is made."""
    with pytest.raises(
        InputError, match="the world's marker 50 is not in DICT_4X4_50, whose markers are 0 to 49"
    ):
        world(MARKER.model_copy(update={"marker_id": 50}))
