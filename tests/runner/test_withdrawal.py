"""Withdrawal of a needle along its path."""

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from labrig.devices.axis_positions import AxisPositions, collect_axis_positions
from labrig.devices.operator import (
    ConfirmAxesAtZero,
    ConfirmNeedleOut,
    MountNeedle,
    PlaceSpecimen,
    ShiftToHole,
)
from labrig.errors import DriveError, SafetyStopError
from labrig.record.events import TrialStart
from labrig.record.reader import open_run
from labrig.runner.withdrawal import plan_reverse_moves, read_needle_path, withdraw
from tests.runner.sessions import RunBench, Watched, bench, sweep

Path3 = Sequence[tuple[float, float, float]]
TURNED: Path3 = ((0, 0, 0), (0, 0, 10), (10, 0, 10), (10.004, 1.5, 10), (10.001, 3.1, 10), (25, 3.1, 10))
OVERSHOT = tuple((20, rad, 5) for rad in (0.0, 1.6, 3.3, 3.6, 3.3, 3.14))
OUT = [("insertion", 0.0), ("linear", 0.0)]
PATHS: dict[str, tuple[Path3, list[tuple[str, float]]]] = {
    "a turn": (TURNED, [("insertion", 10.0), ("rotation", 0.0), *OUT]),
    "its overshoot": (((0, 0, 5), *OVERSHOT, (50, 3.14, 5)), [("insertion", 20.0), ("rotation", 0.0), *OUT]),
    "gone back already": ((*TURNED, (10, 3.1, 10), (10, 0, 10), (4, 0, 10)), OUT),
    "a turn in the sheath": (((0, 0, 0), (0, 3, 0), (0, 3, 10), (20, 3, 10)), OUT),
    "nothing in": (((0, 0, 0), (0, 2, 0)), []),
    "no path": ((), []),
}


def read_path(path: Path3) -> tuple[AxisPositions, ...]:
    """Return the positions of a path."""
    return tuple(AxisPositions(*positions) for positions in path)


@pytest.mark.parametrize(("path", "moves"), PATHS.values(), ids=PATHS)
def test_a_path_is_gone_back(path: Path3, moves: list[tuple[str, float]]) -> None:
    """A turn is undone once, where it was made; what was retracted already, or was never in, is not gone in again."""
    assert [(move.axis, round(move.position, 2)) for move in plan_reverse_moves(read_path(path))] == moves


stances = st.builds(AxisPositions, *(st.floats(*limits) for limits in ((-1, 60), (-6, 6), (0, 20))))


@given(st.lists(stances, max_size=30))
def test_a_withdrawal_never_goes_deeper(path: list[AxisPositions]) -> None:
    """For any path the needle only moves back, the sheath moves last, and both end at zero or before it."""
    moves = plan_reverse_moves(path)
    depths = [path[-1].insertion_mm, *(m.position for m in moves if m.axis == "insertion")] if path else [0]
    assert all(after < before for before, after in pairwise(depths))
    assert depths[-1] <= 0
    assert all(move.axis != "linear" for move in moves[:-1])


@given(st.lists(st.tuples(st.floats(0.1, 5), st.floats(-2, 2)), min_size=1, max_size=8))
def test_the_roll_at_every_depth_is_what_it_was_on_the_way_in(steps: list[tuple[float, float]]) -> None:
    """The moves pass every depth with the roll of the insertion."""
    path = [AxisPositions(0, 0, 0)]
    for length_mm, turn_rad in steps:
        deeper, roll_rad = path[-1].insertion_mm + length_mm, path[-1].rotation_rad
        path += [AxisPositions(deeper, roll_rad, 0), AxisPositions(deeper, roll_rad + turn_rad, 0)]
    depth_mm, roll_rad = path[-1].insertion_mm, path[-1].rotation_rad
    for move in plan_reverse_moves(path):
        if move.axis == "rotation":
            roll_rad = move.position
            continue
        between = [s for s in path if move.position + 1e-9 < s.insertion_mm < depth_mm - 1e-9]
        assert all(abs(s.rotation_rad - roll_rad) <= 0.05 + 1e-9 for s in between)
        depth_mm = move.position


def _turn_in_gel(rig: RunBench) -> None:
    """Insert the needle into gel and turn its bevel on the way."""
    session = rig.session
    for request in (MountNeedle("N-1"), ConfirmAxesAtZero()):
        session.ask(request)
    rig.opened.rig.enable()
    rig.opened.rig.reference_axes()
    session.ask(PlaceSpecimen("gel-10", 10))
    session.ask(ShiftToHole("gel-10", 0, 0))
    session.record(TrialStart(trial=0))
    rig.opened.rig.needle.mark_in_tissue("run")
    for axis, position in (("linear", 5), ("insertion", 6), ("rotation", 3), ("insertion", 14)):
        session.move(axis, position, session.axis(axis).nearest_speed(3.0))


def test_a_recorded_path_is_gone_back(tmp_path: Path) -> None:
    """The recorded path takes the needle out, after which it counts as out."""
    with bench(tmp_path, sweep()) as rig:
        _turn_in_gel(rig)
        path = read_needle_path(open_run(rig.recorder.path))
        assert [round(path[-1].insertion_mm, 2), round(path[-1].rotation_rad, 2)] == [14, 3]
        withdraw(rig.session, path)
        stance = collect_axis_positions(rig.opened.rig.read_states())
        assert max(map(abs, vars(stance).values())) < 0.01
        assert rig.opened.rig.state.needle_in_tissue is False


def test_a_needle_without_reference_is_out_when_a_person_says_so(tmp_path: Path) -> None:
    """After a power cut the needle is withdrawn from confirmed positions."""
    with bench(tmp_path, sweep()) as rig:
        _turn_in_gel(rig)
        axis = rig.opened.rig.axis("insertion")
        axis.referenced = False
        rig.opened.rig.needle.forget_references(["insertion"])
        axis.assume_position(14.5)
        watched = rig.opened.rig.operator = Watched(rig.opened.rig.operator, declines=ConfirmNeedleOut)
        path = read_path(((0, 0, 0), (6, 0, 5), (6, 3, 5), (14, 3, 5)))
        with pytest.raises(SafetyStopError, match="no needle is in tissue"):
            withdraw(rig.session, path)
        assert rig.opened.rig.state.needle_in_tissue is True
        assert abs(axis.read().position) < 0.01
        watched.declines = None
        withdraw(rig.session, path)
        assert rig.opened.rig.state.needle_in_tissue is False


def test_a_fault_on_the_way_out_leaves_the_needle_in_tissue(tmp_path: Path) -> None:
    """After an incomplete withdrawal the needle still counts as in tissue."""
    with bench(tmp_path, sweep()) as rig:
        _turn_in_gel(rig)
        rig.opened.hardware.drives["insertion"].shaft.jam()
        with pytest.raises(DriveError):
            withdraw(rig.session, (AxisPositions(0, 0, 0),))
        assert rig.opened.rig.state.needle_in_tissue is True
