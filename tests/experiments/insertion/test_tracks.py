"""The track of an insertion in its block of gel."""

import pytest

from labrig.experiments.declared import PROTOCOL_MODELS
from labrig.experiments.insertion.protocol import InsertionProtocol
from labrig.experiments.insertion.tracks import find_track_problems, make_shape, make_straight_shape
from labrig.protocol.load import load_protocol
from tests.protocol.specimens import make_section, make_track
from tests.runner.sessions import PROTOCOLS


def protocol(*places_mm: float) -> InsertionProtocol:
    """Return the example insertion, 5 mm from the first entry point of a block with tracks at these places."""
    loaded = load_protocol(PROTOCOLS / "insertion.yaml", PROTOCOL_MODELS)
    assert isinstance(loaded, InsertionProtocol)
    section = make_section(*(make_track(place_mm) for place_mm in places_mm))
    specimen = loaded.specimen.model_copy(update={"name": "A1", "block": section, "first_hole_mm": 5.0})
    return loaded.model_copy(update={"specimen": specimen})


def test_a_path_of_the_plane_lies_in_the_block_where_it_entered() -> None:
    """y of the plane is against the order of the holes, z begins at the sheath's end; long paths are thinned."""
    depth_mm = protocol().sheath.depth_mm
    path_mm = [(0.05 * step, float(step)) for step in range(61)]
    shape = make_shape(protocol(), path_mm)
    assert (shape.path_mm[0], shape.path_mm[-1]) == ((depth_mm, 5.0), (depth_mm + 60.0, 2.0))
    assert len(shape.path_mm) <= 20
    assert make_straight_shape(protocol()).path_mm[-1][1] == 0.0


@pytest.mark.parametrize(("y_mm", "crosses"), [(-8.0, True), (8.0, False)])
def test_a_planned_path_that_meets_an_old_track_is_refused(y_mm: float, crosses: bool) -> None:
    """A path towards -y meets the track of a later hole, one towards +y does not."""
    path_mm = [(0.0, 0.0), (y_mm, 25.0)]
    problems = list(find_track_problems(protocol(12.0), path_mm))
    assert bool(problems) == crosses
