"""No command takes a drive beyond the limits of its axis, as its shaft and journal show."""

from hypothesis import example, given, settings
from hypothesis import strategies as st

from labrig.devices.drives import objects as co
from labrig.errors import LimitError
from tests.devices.rigs import OpenedRig, opened_rig, simulated_rig

RIG = simulated_rig("axes.insertion.backlash=0.3", "axes.linear.reversed=true")
AXES = ("insertion", "rotation", "linear")
ANYTHING = st.one_of(
    st.floats(),
    st.floats(-200, 200),
    st.sampled_from([-2.0, 120.0, -13.0, 13.0, -5.0, 150.0, 120.001, -2.0001]),
)
SPEED = st.one_of(st.floats(), st.floats(0.5, 20), st.just(20.0))


def _beyond(opened: OpenedRig) -> list[str]:
    """Return every axis whose shaft stands beyond its limits, by more than a quadcount."""
    places = []
    for name, axis in RIG.axes.items():
        position = axis.scale().to_position(opened.drives[name].shaft_counts)
        low, high = axis.limits
        slack = 1 / axis.scale().counts_per_unit
        if not low - slack <= position <= high + slack:
            places.append(f"{name} at {position}")
    return places


@settings(max_examples=60)
@given(st.lists(st.tuples(st.sampled_from(AXES), ANYTHING, SPEED, st.floats(0, 30)), max_size=8))
@example([("insertion", 120.0, 20.0, 7.0), ("insertion", -2.0, 20.0, 30.0), ("linear", 150.0, 20.0, 30.0)])
def test_no_moves_at_all_take_an_axis_beyond_its_limits(
    moves: list[tuple[str, float, float, float]],
) -> None:
    """Refused, made or replaced, with backlash and reversed axes: no move ends in a fault."""
    with opened_rig(RIG) as opened:
        opened.rig.connect()
        opened.rig.reference_axes()
        beyond: list[str] = []
        opened.hardware.clock.on_advance(lambda: beyond.extend(_beyond(opened)))
        for name, position, speed, wait_s in moves:
            try:
                opened.rig.axis(name).start_move(position, speed)
            except LimitError:
                continue
            for _ in range(int(wait_s / 0.1)):
                opened.rig.wait(0.1)
        opened.rig.stop()
        assert beyond == []
        for drive in opened.drives.values():
            assert drive.find_last("emergency") is None
            assert drive.objects.value(co.ERROR_COUNT) == 0
