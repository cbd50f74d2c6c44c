"""The search for the value at which fewer than half arrive: what it tries, what it finds, and when it ends."""

import math
from collections.abc import Callable

import numpy as np
import pytest

from labrig.campaign.margin_search import (
    Ask,
    Tallies,
    Tally,
    Way,
    estimate_left,
    find_answer,
    find_next,
    find_safe,
    find_sure_sides,
)


def search(way: Way, arrives: Callable[[float, int], bool], most: int = 30) -> tuple[Tallies, float | None]:
    """Search to the end; `arrives` says whether a repetition does at a distance."""
    tallies: dict[float, Tally] = {}
    while (ask := find_next(way, tallies, most)) is not None:
        assert estimate_left(way, tallies, most) > 0
        tally = tallies.get(ask.distance, Tally())
        assert tally.n < ask.repetitions <= most
        for repetition in range(tally.n, ask.repetitions):
            tally = tally.add(None if arrives(ask.distance, repetition) else "missed")
        tallies[ask.distance] = tally
    assert estimate_left(way, tallies, most) == 0
    return tallies, find_answer(way, tallies, most)


def test_the_answer_is_where_fewer_than_half_arrive_and_is_repeated_to_the_end() -> None:
    """Of repetitions that each stop to arrive at their own distance, the answer is just beyond the median."""
    ends = np.random.default_rng(1).normal(10.0, 2.0, 30)
    tallies, answer = search(Way(1.0, 100.0), lambda distance, repetition: distance < ends[repetition])
    median = float(np.median(ends))
    assert answer is not None
    assert median <= answer <= 1.2 * median
    assert tallies[answer].n == 30
    assert 2 * tallies[answer].arrived < 30
    more, fewer = find_sure_sides(tallies, answer)
    assert more is not None
    assert fewer is not None
    assert more < answer <= fewer


def test_what_decides_soon_is_left_soon() -> None:
    """Where all arrive, or none, five repetitions are enough, except at the answer."""
    tallies, answer = search(Way(1.0, 100.0), lambda distance, _: distance < 11.0)
    assert answer is not None
    assert 11.0 <= answer <= 12.7
    assert {tally.n for distance, tally in tallies.items() if distance != answer} == {5}


def test_where_half_arrive_up_to_the_limit_there_is_no_answer() -> None:
    """The limit itself is tried, and is the farthest."""
    tallies, answer = search(Way(1.0, 6.0), lambda *_: True)
    assert answer is None
    assert list(tallies) == [1.0, 2.0, 4.0, 6.0]
    assert find_safe(tallies) == 6.0
    assert find_sure_sides(tallies, answer) == (6.0, None)


def test_one_and_two_standard_deviations_are_tried_even_if_the_first_misses() -> None:
    """Both have ten repetitions; two that lie beyond the limit are left out."""
    tallies, answer = search(Way(0.6, 30.0, sd=0.6), lambda distance, _: distance < 0.3)
    assert answer is not None
    assert 0.3 <= answer < 0.36
    assert [tallies[distance].n for distance in (0.6, 1.2)] == [10, 10]
    assert Way(0.6, 1.0, sd=0.6).at_sds == (0.6,)


def test_whole_numbers_are_found_to_the_one() -> None:
    """A search among whole numbers ends at the first that misses."""
    tallies, answer = search(Way(1.0, 20.0, whole=True), lambda distance, _: distance < 7)
    assert answer == 7.0
    assert all(distance.is_integer() for distance in tallies)


def test_a_value_that_missed_at_first_and_arrives_in_the_end_is_passed() -> None:
    """The first five at 2 miss and most of the later ones arrive: repeated to the end, 2 is no answer."""
    tallies, answer = search(
        Way(2.0, 32.0), lambda distance, repetition: distance < 3.0 and (distance != 2.0 or repetition >= 5)
    )
    assert tallies[2.0].n == 30
    assert answer is not None
    assert 3.0 <= answer < 3.5


@pytest.mark.parametrize("most", [2, 3, 4, 30])
def test_few_repetitions_end_too(most: int) -> None:
    """With fewer than five, the share itself decides."""
    _, answer = search(Way(1.0, 100.0), lambda distance, _: distance < 3.0, most)
    assert answer is not None
    assert 3.0 <= answer < 3.6
    assert find_next(Way(1.0, 100.0), {}, most) == Ask(1.0, min(5, most))


def test_nothing_that_nearly_always_misses_is_told_from_the_stated_value() -> None:
    """A search that misses ever nearer to the stated value ends at a thirty-second of the first step."""
    _, answer = search(Way(1.0, 100.0), lambda *_: False)
    assert answer is not None
    assert answer <= 1.0 / 32.0
    assert math.isclose(math.log2(answer), round(math.log2(answer)))
