"""The closed-form velocity profile of the simulated drive."""

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from labrig.devices.trapezoid import Limits, make_move_profile

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
