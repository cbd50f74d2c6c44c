"""The specimens of a protocol before a run."""

from labrig.library.specimens import find_too_many
from labrig.protocol.specimen_file import MOST_TRACKS
from tests.protocol.specimens import make_track


def test_more_tracks_than_a_record_keeps_are_refused() -> None:
    """The tracks of all blocks count together, and the message has both numbers."""
    tracks = (make_track(),) * (MOST_TRACKS // 2)
    assert find_too_many("specimens.0", {"A1": tracks, "A2": tracks}) == []
    (problem,) = find_too_many("specimens.0", {"A1": tracks, "A2": (*tracks, make_track())})
    assert f"have {MOST_TRACKS + 1} tracks, and a record keeps {MOST_TRACKS}" in problem.message
