"""The simulated bench: the effect of hands and axes, and its memory."""

import json
import math

import numpy as np
import pytest

from labrig.errors import InputError
from labrig.simulation.description import SheathDescription, WorldDescription
from tests.simulation.benches import bench, centre_line_mm, insert, withdraw


def session(seed: int) -> tuple[bytes, ...]:
    """Return the pictures of a short session."""
    world, pictures = bench(WorldDescription(), seed), list[bytes]()
    for act in (
        lambda: insert(world, 20.0), lambda: withdraw(world), lambda: world.shift_to_hole("A", 1, 45.0),
        lambda: world.lay_graph_paper(1.0), lambda: world.hold_board(0, 9, 6, 25.0),
    ):  # fmt: skip
        act()
        pictures.append(world.picture().tobytes())
    return tuple(pictures)


def test_the_same_seed_gives_the_same_pictures_byte_for_byte() -> None:
    """Two worlds with one seed and the same actions give the same pictures; another seed gives others."""
    first = session(3)
    assert first == session(3)
    assert all(ours != theirs for ours, theirs in zip(first, session(4), strict=True))


def test_the_needle_withdraws_along_its_path_and_follows_it_again() -> None:
    """Turned while withdrawn, it follows its old path, and bends the other way only beyond it."""
    world = bench()
    insert(world, 20.0)
    first = centre_line_mm(world)
    for inserted_mm in (0.0, 20.0, 40.0, 20.0):
        world.advance(inserted_mm, math.pi, 15.0)
        if inserted_mm == 20.0:
            assert centre_line_mm(world) == pytest.approx(first, abs=1e-9)
        elif inserted_mm == 40.0:
            y, z = centre_line_mm(world)[-40:].T
            assert np.all(np.diff(np.diff(y) / np.diff(z)) > 0)


def test_truth_tells_the_insertion_before_and_after_it_is_withdrawn() -> None:
    """Radius, sheath tip, deepest tip and length stay true of the hole, and go into JSON."""
    world = bench(WorldDescription(sheath=SheathDescription(lateral_play_sd_mm=0, angle_play_sd_deg=0)))
    insert(world, 40.0)
    deepest = world.truth()
    withdraw(world)
    assert world.truth() == deepest == json.loads(json.dumps(deepest))
    assert deepest["sheath_tip_mm"] == [0.0, 0.0]
    assert deepest["arc_length_mm"] == 40.0
    assert (deepest["specimen"], deepest["gelatin_percent"], deepest["hole"]) == ("A", 13.0, 0)


def test_a_needle_is_carried_along_its_path_by_the_linear_axis() -> None:
    """2 mm of linear axis with the needle out move its tip on by 2 mm of arc, and back again."""
    world = bench()
    insert(world, 20.0)
    world.advance(20.0, 0.0, 17.0)
    tip = centre_line_mm(world)[-1]
    assert world.truth()["arc_length_mm"] == pytest.approx(22.0)
    world.advance(20.0, 0.0, 13.0)
    assert len(centre_line_mm(world)) > 0
    world.advance(22.0, 0.0, 15.0)
    assert centre_line_mm(world)[-1] == pytest.approx(tip)


@pytest.mark.parametrize(("insertion_mm", "linear_mm"), [(5.0, 0.0), (0.0, 15.0)])
def test_the_gel_is_not_moved_with_the_instrument_in_it(insertion_mm: float, linear_mm: float) -> None:
    """Shifting the gel with needle or sheath in it is refused, with the depth."""
    world = bench()
    world.advance(insertion_mm, 0.0, linear_mm)
    with pytest.raises(InputError, match=f"{insertion_mm + linear_mm:.1f} mm deep in A"):
        world.shift_to_hole("A", 1, 45.0)
    for change in (
        lambda: world.place_specimen("B", 13.0),
        world.clear_bench,
        lambda: world.mount_needle("N2"),
    ):
        with pytest.raises(InputError, match="deep in A"):
            change()


@pytest.mark.parametrize("position_mm", [-1.0, 241.0, math.nan])
def test_a_hole_outside_of_the_gel_is_refused(position_mm: float) -> None:
    """A hole position outside 0 to 240 mm is refused."""
    with pytest.raises(InputError, match="0 to 240 mm"):
        bench().shift_to_hole("A", 0, position_mm)


def test_a_specimen_put_back_has_kept_its_tracks() -> None:
    """Back at an old hole, the needle follows the track it cut there."""
    world = bench()
    insert(world, 30.0)
    withdraw(world)
    before = world.truth()
    world.place_specimen("B", 16.0)
    world.place_specimen("A", 13.0)
    world.shift_to_hole("A", 0, 35.0)
    assert world.truth() == before
