"""Planned tracks beside old ones."""

import pytest

from labrig.experiments.shared.hole_map import (
    TrackShape,
    compute_gap_mm,
    find_crossings,
    find_place,
    sample_arc,
)
from labrig.protocol.sections import TrackedSpecimen
from tests.protocol.specimens import make_section, make_track


def gel(*places_mm: float, **changed: object) -> TrackedSpecimen:
    """Return a gel with straight old tracks at these places."""
    section = make_section(*(make_track(place_mm) for place_mm in places_mm))
    return TrackedSpecimen(name="A1", gelatin_percent=10.0, block=section).model_copy(update=changed)


def straight(place_mm: float) -> TrackShape:
    """Return the shape of a straight track."""
    return TrackShape.of_track(make_track(place_mm))


def test_the_gap_of_two_tracks_is_between_their_surfaces() -> None:
    """Beside each other the sheaths are closest; tracks that cross overlap by a radius of each needle."""
    assert compute_gap_mm(straight(0.0), straight(5.0)) == pytest.approx(5.0 - 2.0)
    across = TrackShape.of_track(make_track(9.0, path_mm=((15.0, 9.0), (40.0, -9.0))))
    assert compute_gap_mm(straight(0.0), across) == pytest.approx(-1.2)


def test_an_arc_bends_to_its_side_and_keeps_its_length() -> None:
    """The arc begins at the sheath's end and ends where the circle does."""
    points = sample_arc(10.0, 15.0, 30.0, 30.0, side=-1)
    assert (points[0], len(points)) == ((15.0, 10.0), 17)
    assert points[-1] == pytest.approx((15.0 + 30.0 * 0.84147, 10.0 - 30.0 * (1 - 0.54030)), abs=0.01)


def test_a_track_too_close_to_an_old_one_is_refused_with_a_free_place() -> None:
    """The error names hole, run, distance and limit, and the place that it proposes is the first that is clear."""
    block = gel(0.0, 10.0)
    (problem,) = find_crossings("specimens.0", block, [straight(7.0), straight(13.0)], 100.0)
    assert problem.where == "specimens.0.first_hole_mm"
    assert (
        "hole 1, at 7 mm, would pass 1.00 mm from the track of hole 1 of run earlier, at 10 mm"
        in problem.message
    )
    assert "the least clearance is 2 mm; so would 1 hole more" in problem.message
    assert problem.hint.startswith("first_hole_mm: 14 is clear for all 2 holes")
    assert list(find_crossings("specimens.0", block, [straight(14.0), straight(20.0)], 100.0)) == []


def test_a_crossing_may_be_allowed_and_a_gel_without_a_file_has_no_tracks() -> None:
    """`allow_crossing: true` and a gel that is described by the protocol alone refuse nothing."""
    for block in (gel(0.0, allow_crossing=True), gel(0.0, block=None)):
        assert list(find_crossings("specimens.0", block, [straight(0.0)], 100.0)) == []


def test_a_full_block_has_no_next_hole() -> None:
    """The first place with the clearance is found; where the block ends before that, there is none."""
    block = gel(0.0, 8.0)
    assert find_place(block.block.tracks, [straight(0.0)], 100.0, block) == 4.0
    tight = gel(0.0, 7.5)
    assert find_place(tight.block.tracks, [straight(0.0)], 100.0, tight) == 11.5
    assert find_place(tight.block.tracks, [straight(0.0)], 11.0, tight) is None
