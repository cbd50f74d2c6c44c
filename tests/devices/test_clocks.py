"""Simulated rig time; real time is tried by a rehearsed rig, in test_dead_man.py."""

from itertools import pairwise

from hypothesis import given
from hypothesis import strategies as st

from labrig.devices.clocks import MAX_STEP_S, SimulatedClock


@given(st.lists(st.floats(0, 3), max_size=20))
def test_simulated_time_is_the_sum_of_all_sleeps_and_tells_of_itself(durations: list[float]) -> None:
    """It is exact to a microsecond per sleep, without drift; listeners are called at least every tenth of a second."""
    clock, heard = SimulatedClock(), [0.0]
    clock.on_advance(lambda: heard.append(clock.now_s()))
    for duration in durations:
        clock.sleep(duration)
        assert heard[-1] == clock.now_s()
    assert round(clock.now_s() * 1e6) == sum(round(duration * 1e6) for duration in durations)
    assert all(0 < later - before <= MAX_STEP_S + 1e-9 for before, later in pairwise(heard))
