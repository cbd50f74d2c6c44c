"""The insertions of a sweep, and the remaining ones of an interrupted sweep."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from labrig.errors import InputError
from labrig.experiments.steerability.events import SweepTrialStart, SweepTrialStop
from labrig.experiments.steerability.protocol import SteerabilityProtocol
from labrig.experiments.steerability.schedule import (
    BegunTrial,
    PlannedTrial,
    describe_order,
    describe_place,
    list_planned_trials,
    list_remaining_trials,
)
from tests.protocol.specimens import make_section, make_track
from tests.runner.sessions import sweep

TWO_GELS = "specimens=[{name: a, gelatin_percent: 10}, {name: b, gelatin_percent: 19}]"


def protocol(*overrides: str) -> SteerabilityProtocol:
    """Return a sweep of three holes in each of two gels."""
    loaded = sweep(TWO_GELS, "insertions_per_specimen=3", *overrides)
    assert isinstance(loaded, SteerabilityProtocol)
    return loaded


def begin(planned: PlannedTrial, *, finished: bool) -> BegunTrial:
    """Return a recorded trial."""
    start = SweepTrialStart(
        t_s=0.0,
        trial=planned.trial,
        specimen=planned.specimen.name,
        gelatin_percent=planned.specimen.gelatin_percent,
        hole=planned.hole,
        hole_position_mm=planned.hole_position_mm,
        needle_id="n",
        repeats=planned.repeats,
    )
    exit_status = "success" if finished else "interrupted"
    return BegunTrial(start, SweepTrialStop(t_s=1.0, trial=planned.trial, exit_status=exit_status))


def test_a_fresh_sweep_goes_from_hole_to_hole() -> None:
    """Trials are numbered through the sweep; holes are numbered within each block."""
    trials = list_planned_trials(protocol())
    assert [(trial.trial, trial.specimen.name, trial.hole, trial.hole_position_mm) for trial in trials] == [
        (0, "a", 0, 0.0), (1, "a", 1, 10.0), (2, "a", 2, 20.0),
        (3, "b", 0, 0.0), (4, "b", 1, 10.0), (5, "b", 2, 20.0),
    ]  # fmt: skip
    assert list_remaining_trials(protocol(), ()) == trials


def test_an_interrupted_trial_is_repeated_behind_the_last_hole() -> None:
    """A repeated trial gets its own number, hole and place; trials not yet begun keep theirs."""
    trials = list_planned_trials(protocol())
    past = [begin(trials[0], finished=True), begin(trials[1], finished=False)]
    left = list_remaining_trials(protocol(), past)
    assert [(trial.trial, trial.hole, trial.hole_position_mm, trial.repeats) for trial in left] == [
        (2, 2, 20.0, None), (6, 3, 30.0, 1), (3, 0, 0.0, None), (4, 1, 10.0, None), (5, 2, 20.0, None),
    ]  # fmt: skip


def test_a_narrow_block_is_entered_between_two_holes() -> None:
    """Without room beyond the last hole, a trial is repeated at the nearest free place halfway between two holes."""
    narrow = protocol("specimen_width_mm=44")
    trials = list_planned_trials(narrow)
    past = [begin(trial, finished=trial.trial != 2) for trial in trials[:3]]
    left = list_remaining_trials(narrow, past)
    assert (left[0].hole_position_mm, left[0].hole, left[0].repeats) == (15.0, 3, 2)


def test_a_block_without_room_is_refused() -> None:
    """A block without a free place is refused; block and trial are named."""
    narrow = protocol("specimen_width_mm=44")
    past = [begin(trial, finished=False) for trial in list_planned_trials(narrow)[:3]]
    with pytest.raises(InputError, match=r"specimen a has no room for another entry point, in which trial 2"):
        list_remaining_trials(narrow, past)


def test_a_random_order_is_of_the_seed_and_the_block() -> None:
    """Each block has an order of its own; the same seed gives the same one, another seed another, holes keep places."""
    orders = [
        [
            [trial.hole for trial in list_planned_trials(drawn) if trial.specimen.name == gel]
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
    seven = protocol("insertions_per_specimen=18", "hole_order=random", "seed=7")
    assert next(iter(describe_order(seven))).startswith("holes of a, in this order: 7, 4, 13, 12, ")
    assert not list(describe_order(protocol()))
    drawn = list_planned_trials(protocol("hole_order=random"))
    assert [trial.trial for trial in drawn] == list(range(6))
    assert all(trial.hole_position_mm == 10.0 * trial.hole for trial in drawn)


def test_a_random_order_keeps_its_rest_and_repeats_last() -> None:
    """What an interrupted sweep has left is the rest of its order; the repeated trial comes last in its block."""
    drawn = protocol("hole_order=random")
    trials = list_planned_trials(drawn)
    left = list_remaining_trials(drawn, [begin(trials[0], finished=False)])
    assert [trial.trial for trial in left] == [1, 2, 6, 3, 4, 5]
    assert (left[0], left[2].repeats) == (trials[1], 0)
    assert describe_place(drawn, left[0]) == f"hole {trials[1].hole + 1} (2nd of 3)"
    assert describe_place(drawn, left[2]) == "hole 4 (repeats trial 0)"
    assert describe_place(protocol(), list_planned_trials(protocol())[4]) == "hole 2 of 3"


@pytest.mark.parametrize("order", ["sequential", "random"])
@given(st.lists(st.integers(0, 9), min_size=1, max_size=6))
def test_however_often_it_is_interrupted_every_planned_trial_is_finished_once(
    order: str, cuts: list[int]
) -> None:
    """After any number of interruptions every planned trial is finished once, each at a place of its own."""
    wide = protocol("specimen_width_mm=1000", f"hole_order={order}")
    past: list[BegunTrial] = []
    for cut in cuts:
        left = list_remaining_trials(wide, past)
        past += [begin(trial, finished=number < cut) for number, trial in enumerate(left[: cut + 1])]
    past += [begin(trial, finished=True) for trial in list_remaining_trials(wide, past)]
    finished = [trial for trial in past if trial.exit_status == "success"]
    starts = [trial.start for trial in past]
    assert len(finished) == len(list_planned_trials(wide))
    assert len({start.trial for start in starts}) == len(past)
    assert len({(start.specimen, start.hole_position_mm) for start in starts}) == len(past)
    assert len({(start.specimen, start.hole) for start in starts}) == len(past)
    assert list_remaining_trials(wide, past) == ()


def test_a_repeated_hole_keeps_off_old_tracks() -> None:
    """The place behind the last hole is taken by the track of an earlier run: the repetition goes halfway instead."""
    loaded = protocol("specimens=[{name: A1, gelatin_percent: 10}]")
    old = make_track(30.0)
    (gel,) = loaded.specimens
    sweep_in_a1 = loaded.model_copy(
        update={"specimens": (gel.model_copy(update={"block": make_section(old)}),)}
    )
    begun = [begin(trial, finished=trial.trial != 1) for trial in list_planned_trials(sweep_in_a1)]
    (again,) = list_remaining_trials(sweep_in_a1, begun)
    assert (again.repeats, again.hole_position_mm) == (1, 5.0)
    assert list_remaining_trials(loaded, begun)[0].hole_position_mm == 30.0
