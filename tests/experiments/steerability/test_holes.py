"""The insertions of a sweep, and the remaining ones of an interrupted sweep."""

from collections.abc import Sequence
from functools import partial

import pytest
from hypothesis import given
from hypothesis import strategies as st

from labrig.errors import InputError
from labrig.experiments.steerability.holes import (
    Hole,
    describe_place,
    find_another_hole,
    list_holes,
    sort_holes,
)
from labrig.experiments.steerability.protocol import SteerabilityProtocol
from labrig.record.events import NO_DECISIONS
from labrig.runner.trials import AnyTrial, Trial, list_remaining
from tests.protocol.specimens import make_section, make_track
from tests.runner.sessions import begun, sweep

TWO_GELS = "specimens=[{name: a, gelatin_percent: 10}, {name: b, gelatin_percent: 19}]"


def protocol(*overrides: str) -> SteerabilityProtocol:
    """Return a sweep of three holes in each of two gels."""
    loaded = sweep(TWO_GELS, "insertions_per_specimen=3", *overrides)
    assert isinstance(loaded, SteerabilityProtocol)
    return loaded


def begin(planned: Trial[Hole], *, finished: bool) -> AnyTrial:
    """Return a recorded trial."""
    return begun(planned.number, planned.repeats, "success" if finished else "interrupted")


def list_planned(sweep_of: SteerabilityProtocol) -> list[Trial[Hole]]:
    """Return every trial."""
    return [Trial(number, hole) for number, hole in enumerate(list_holes(sweep_of))]


def list_left(sweep_of: SteerabilityProtocol, begun: Sequence[AnyTrial]) -> list[Trial[Hole]]:
    """Return the trials that remain, as the procedure asks for them."""
    again = partial(find_another_hole, sweep_of)
    return list_remaining(list_holes(sweep_of), begun, NO_DECISIONS, again, sort_holes(sweep_of))


def test_a_fresh_sweep_goes_from_hole_to_hole() -> None:
    """Trials are numbered through the sweep; holes are numbered within each block."""
    trials = list_planned(protocol())
    holes = [(trial.number, trial.what) for trial in trials]
    assert [(number, hole.specimen.name, hole.number, hole.position_mm) for number, hole in holes] == [
        (0, "a", 0, 0.0), (1, "a", 1, 10.0), (2, "a", 2, 20.0),
        (3, "b", 0, 0.0), (4, "b", 1, 10.0), (5, "b", 2, 20.0),
    ]  # fmt: skip
    assert list_left(protocol(), ()) == trials


def test_an_interrupted_trial_is_made_again_where_its_block_has_room() -> None:
    """Behind the last hole under a number of its own; else halfway between two; without room the block is named."""
    trials, narrow = list_planned(protocol()), protocol("specimen_width_mm=44")
    left = list_left(protocol(), [begin(trials[0], finished=True), begin(trials[1], finished=False)])
    assert [(trial.number, trial.what.number, trial.what.position_mm, trial.repeats) for trial in left] == [
        (2, 2, 20.0, None), (6, 3, 30.0, 1), (3, 0, 0.0, None), (4, 1, 10.0, None), (5, 2, 20.0, None),
    ]  # fmt: skip
    again, *_ = list_left(narrow, [begin(trial, finished=trial.number != 2) for trial in trials[:3]])
    assert (again.what.position_mm, again.what.number, again.repeats) == (15.0, 3, 2)
    with pytest.raises(InputError, match=r"specimen a has no room for another entry point"):
        list_left(narrow, [begin(trial, finished=False) for trial in trials[:3]])


def test_a_random_order_is_of_the_seed_and_the_block() -> None:
    """Each block has an order of its own; the same seed gives the same one, another seed another, holes keep places."""
    orders = [
        [
            [trial.what.number for trial in list_planned(drawn) if trial.what.specimen.name == gel]
            for gel in ("a", "b")
        ]
        for seed in (7, 7, 8)
        for drawn in [protocol("insertions_per_specimen=18", "hole_order=random", f"seed={seed}")]
    ]
    assert orders[0] == orders[1] != orders[2]
    assert orders[0][0] != orders[0][1]
    assert all(sorted(order) == list(range(18)) for order in orders[0])
    # As NumPy draws it in every version: a later one has to replay the record.
    assert orders[0][0] == [6, 3, 12, 11, 4, 10, 13, 9, 14, 15, 0, 2, 17, 8, 7, 5, 1, 16]
    drawn = list_planned(protocol("hole_order=random"))
    assert [trial.number for trial in drawn] == list(range(6))
    assert all(trial.what.position_mm == 10.0 * trial.what.number for trial in drawn)


def test_a_random_order_keeps_its_rest_and_repeats_last() -> None:
    """What an interrupted sweep has left is the rest of its order; the repeated trial comes last in its block."""
    drawn = protocol("hole_order=random")
    trials = list_planned(drawn)
    left = list_left(drawn, [begin(trials[0], finished=False)])
    assert [trial.number for trial in left] == [1, 2, 6, 3, 4, 5]
    assert (left[0], left[2].repeats) == (trials[1], 0)
    told = [describe_place(drawn, trial.number, trial.what, trial.repeats) for trial in (left[0], left[2])]
    hole = trials[1].what.number + 1
    assert told == [f"insertion 2, hole {hole} of 3", "insertion 7, hole 4 in place of trial 1"]
    assert describe_place(protocol(), 4, list_planned(protocol())[4].what, None) == "hole 2 of 3"


@pytest.mark.parametrize("order", ["sequential", "random"])
@given(st.lists(st.integers(0, 9), min_size=1, max_size=6))
def test_however_often_it_is_interrupted_every_planned_trial_is_finished_once(
    order: str, cuts: list[int]
) -> None:
    """After any number of interruptions every planned trial is finished once, each at a place of its own."""
    wide = protocol("specimen_width_mm=1000", f"hole_order={order}")
    past: list[AnyTrial] = []
    used: list[Hole] = []
    for cut in (*cuts, len(list_planned(wide))):
        left = list_left(wide, past)
        past += [begin(trial, finished=number < cut) for number, trial in enumerate(left[: cut + 1])]
        used += [trial.what for trial in left[: cut + 1]]
    assert len([trial for trial in past if trial.exit_status == "success"]) == len(list_planned(wide))
    for kept in (
        {trial.start.trial for trial in past},
        {(hole.specimen.name, hole.position_mm) for hole in used},
        {(hole.specimen.name, hole.number) for hole in used},
    ):
        assert len(kept) == len(past)
    assert list_left(wide, past) == []


def test_a_repeated_hole_keeps_off_old_tracks() -> None:
    """The place behind the last hole is taken by the track of an earlier run: the repetition goes halfway instead."""
    loaded = protocol("specimens=[{name: A1, gelatin_percent: 10}]")
    old = make_track(30.0)
    (gel,) = loaded.specimens
    sweep_in_a1 = loaded.model_copy(
        update={"specimens": (gel.model_copy(update={"block": make_section(old)}),)}
    )
    begun = [begin(trial, finished=trial.number != 1) for trial in list_planned(sweep_in_a1)]
    (again,) = list_left(sweep_in_a1, begun)
    assert (again.repeats, again.what.position_mm) == (1, 5.0)
    assert list_left(loaded, begun)[0].what.position_mm == 30.0
