"""What a session remembers of the needle by itself, whoever wrote the procedure."""

import pytest

from labrig.devices.needle_state import NEW
from labrig.devices.operator import ClearBench, PlaceSpecimen
from labrig.errors import SafetyStopError
from labrig.runner.session import Session
from labrig.runner.virtual_rig import EventList, VirtualRig
from labrig.simulation.world import World
from tests.devices.rigs import large_rig


@pytest.fixture
def session() -> Session:
    """Return a session on a virtual rig whose axes are referenced; before that none of them moves."""
    rig = large_rig()
    assert rig.world is not None
    made = Session(VirtualRig(rig, World(rig.world, 1), NEW, 0.0), EventList(), lambda _done, _doing: None)
    with pytest.raises(SafetyStopError, match="axis linear is not referenced"):
        made.move("linear", 1.0, 5.0)
    made.reference_axes()
    return made


@pytest.mark.parametrize("axis", ["linear", "insertion"])
def test_needle_and_sheath_count_as_in_tissue_until_both_are_back(session: Session, axis: str) -> None:
    """The session marks it before the move is sent, names its run, and clears it at zero alone."""
    session.ask(PlaceSpecimen("gel", 13.0))
    session.move(axis, 20.0, 5.0)
    assert (session.state.needle_in_tissue, session.state.since_run) == (True, session.run_name)
    session.move(axis, 1.0, 5.0)
    assert session.state.needle_in_tissue is True
    session.move(axis, 0.0, 5.0)
    assert session.state.needle_in_tissue is False


def test_nothing_is_said_to_be_out_while_the_sheath_is_in(session: Session) -> None:
    """The needle is back in its sheath, which still is in the gel."""
    session.move("linear", 15.0, 5.0)
    session.move("insertion", 20.0, 5.0)
    session.move("insertion", 0.0, 5.0)
    assert session.state.needle_in_tissue is True


def test_without_gel_nothing_is_in_tissue(session: Session) -> None:
    """Once a person has said that the bench is clear; turning the bevel marks nothing in any case."""
    session.move("rotation", 1.0, 1.0)
    assert session.state.needle_in_tissue is False
    session.ask(ClearBench("the block"))
    session.move("linear", 15.0, 5.0)
    assert session.state.needle_in_tissue is False
