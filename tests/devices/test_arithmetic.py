"""The arithmetic under the axes: units of a drive, the closed-form velocity profile, and simulated time.

Real time is tried by a rehearsed rig, in test_dead_man.py.
"""

from dataclasses import replace
from itertools import pairwise

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from labrig.devices.clocks import SimulatedClock
from labrig.devices.trapezoid import Limits, make_move_profile
from labrig.devices.units import TURN_RAD, AxisScale

scales = st.builds(
    AxisScale,
    counts_per_turn=st.integers(16, 5000).map(lambda pulses: 4 * pulses),
    gear_ratio=st.floats(0.1, 500),
    travel_per_turn=st.one_of(st.floats(0.1, 100), st.just(TURN_RAD)),
    reversed=st.booleans(),
)
SCREW = AxisScale(2000, 4, 2.0)


@given(scales, st.integers(-(2**31) + 1, 2**31 - 1))
def test_every_counter_survives_the_round_trip(scale: AxisScale, quadcounts: int) -> None:
    """A quadcount in mm or rad converts back to the same quadcount."""
    assert scale.to_counts(scale.to_position(quadcounts)) == quadcounts


@given(scales, st.floats(-1000, 1000))
def test_a_position_is_off_by_at_most_half_a_quadcount(scale: AxisScale, position: float) -> None:
    """Rounding is all that a position loses; reversing changes the sign of the counter, and nothing else."""
    back = scale.to_position(scale.to_counts(position))
    assert abs(back - position) <= 0.5 / scale.counts_per_unit * (1 + 1e-6) + 1e-12 * abs(position)
    assert replace(scale, reversed=not scale.reversed).to_counts(position) == -scale.to_counts(position)


def test_known_screw() -> None:
    """500 lines, 4:1 and a lead of 2 mm: 4000 quadcounts per mm, and 1 mm/s is 120 rpm; 0 rpm no drive accepts."""
    assert SCREW.to_counts(40.0) == 160_000
    assert (SCREW.to_speed_units(1.0), SCREW.to_speed(120)) == (120, 1.0)
    assert SCREW.to_acceleration_units(50.0) == 6000
    assert SCREW.to_speed_units(1e-6) == SCREW.to_distance_counts(1e-9) == 1


positions = st.floats(-1e6, 1e6)
limits = st.builds(
    Limits, speed=st.floats(1, 1e5), acceleration=st.floats(1, 1e6), deceleration=st.floats(1, 1e6)
)


@given(positions, st.floats(-1e5, 1e5), positions, limits)
@example(0.0, 65536.0, 0.0, Limits(1.0, 439_351.0, 1.0))
def test_a_profile_comes_to_rest_at_its_target_without_a_jump(
    start: float, velocity: float, target: float, bounds: Limits
) -> None:
    """From any start; each segment begins where the one before it ends."""
    profile = make_move_profile(1.0, start, velocity, target, bounds)
    assert profile.at(profile.end_s) == (target, 0.0)
    assert profile.end_s >= 1.0
    scale = 1 + abs(start) + abs(target) + velocity**2 / bounds.deceleration
    here = (start, velocity)
    for segment in profile.segments:
        assert (segment.position, segment.velocity) == pytest.approx(here, abs=1e-6 * scale)
        here = segment.end
    assert here[0] == pytest.approx(target, abs=1e-6 * scale)


@given(positions, positions, limits, st.floats(0, 1))
def test_limits_hold_from_rest(start: float, target: float, bounds: Limits, part: float) -> None:
    """A motion from rest exceeds neither the speed nor the range from start to target."""
    profile = make_move_profile(0.0, start, 0.0, target, bounds)
    position, velocity = profile.at(part * profile.end_s)
    slack = 1e-6 * (1 + abs(start) + abs(target))
    assert abs(velocity) <= bounds.speed * (1 + 1e-9)
    assert min(start, target) - slack <= position <= max(start, target) + slack


@given(st.lists(st.floats(0, 3), max_size=20))
def test_simulated_time_is_the_sum_of_all_sleeps_and_tells_of_itself(durations: list[float]) -> None:
    """It is exact to a microsecond per sleep, without drift; listeners are called at least every tenth of a second."""
    clock, heard = SimulatedClock(), [0.0]
    clock.on_advance(lambda: heard.append(clock.now_s()))
    for duration in durations:
        clock.sleep(duration)
        assert heard[-1] == clock.now_s()
    assert round(clock.now_s() * 1e6) == sum(round(duration * 1e6) for duration in durations)
    assert all(0 < later - before <= 0.1 + 1e-9 for before, later in pairwise(heard))
