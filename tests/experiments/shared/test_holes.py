"""Planned holes beside old ones."""

from labrig.experiments.shared.holes import find_near_holes, find_place
from labrig.protocol.sections import TrackedSpecimen
from tests.protocol.specimens import make_section, make_track


def gel(*places_mm: float, **changed: object) -> TrackedSpecimen:
    """Return a gel with straight old tracks at these places."""
    section = make_section(*(make_track(place_mm) for place_mm in places_mm))
    return TrackedSpecimen(name="A1", gelatin_percent=10.0, block=section).model_copy(update=changed)


def test_a_hole_too_close_to_an_old_one_is_refused_with_a_free_place() -> None:
    """The error names hole, run, distance and limit, and the place that it proposes is the first that is clear."""
    block = gel(0.0, 10.0)
    (problem,) = find_near_holes("specimens.0", block, [7.0, 13.0], 2.0, 100.0)
    assert problem.where == "specimens.0.first_hole_mm"
    told = "hole 1, at 7 mm: its sheath would be 1.00 mm from that of hole 1 of run earlier, at 10 mm"
    assert told in problem.message
    assert "the least clearance is 2 mm; so would 1 hole more" in problem.message
    assert problem.hint.startswith("first_hole_mm: 14 is clear for all 2 holes")
    assert list(find_near_holes("specimens.0", block, [14.0, 20.0], 2.0, 100.0)) == []


def test_a_crossing_may_be_allowed_and_a_gel_without_a_file_has_no_tracks() -> None:
    """`allow_crossing: true` and a gel that is described by the protocol alone refuse nothing."""
    for block in (gel(0.0, allow_crossing=True), gel(0.0, block=None)):
        assert list(find_near_holes("specimens.0", block, [0.0], 2.0, 100.0)) == []


def test_a_full_block_has_no_next_hole() -> None:
    """The first place with the clearance is found; where the block ends before that, there is none."""
    assert find_place(gel(0.0, 8.0), [0.0], 2.0, 100.0) == 4.0
    tight = gel(0.0, 7.5)
    assert find_place(tight, [0.0], 2.0, 100.0) == 11.5
    assert find_place(tight, [0.0], 2.0, 11.0) is None
