"""mm and rad to quadcounts and rpm, and back."""

from dataclasses import replace

from hypothesis import given
from hypothesis import strategies as st

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
