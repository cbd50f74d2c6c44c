"""Rig time, real and simulated."""

from itertools import pairwise

from hypothesis import given
from hypothesis import strategies as st

from labrig.devices.clocks import MAX_STEP_S, SimulatedClock, SystemClock, WatchedClock


@given(st.lists(st.floats(0, 3), max_size=20))
def test_simulated_time_is_the_sum_of_all_sleeps(durations: list[float]) -> None:
    """It is exact to a microsecond per sleep, without drift."""
    clock = SimulatedClock()
    for duration in durations:
        clock.sleep(duration)
    assert round(clock.now_s() * 1e6) == sum(round(duration * 1e6) for duration in durations)


@given(st.floats(0, 5))
def test_listeners_are_called_at_least_every_tenth_of_a_second(duration: float) -> None:
    """Time advances in steps of at most 0.1 s, and the last one ends with the sleep."""
    clock, heard = SimulatedClock(), [0.0]
    clock.on_advance(lambda: heard.append(clock.now_s()))
    clock.sleep(duration)
    assert all(0 < later - before <= MAX_STEP_S + 1e-9 for before, later in pairwise(heard))
    assert heard[-1] == clock.now_s()


def test_a_watched_clock_tells_of_the_computers_time_while_somebody_waits() -> None:
    """Its listeners hear of a sleep before it, at its end and often between, and the computer sleeps as long."""
    clock, computer, heard = WatchedClock(), SystemClock(), []
    clock.on_advance(lambda: heard.append(clock.now_s()))
    clock.sleep(0.05)
    assert computer.now_s() >= 0.05
    assert heard == sorted(heard)
    assert heard[-1] - heard[0] >= 0.05
    assert len(heard) >= 3
