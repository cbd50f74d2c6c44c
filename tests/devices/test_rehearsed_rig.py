"""A simulated rig with a real clock: it asks a person, and its drives and its world live in the computer's time."""

from collections.abc import Iterator

import pytest

from labrig.devices.clocks import SystemClock
from labrig.errors import DriveError
from tests.devices.rigs import OpenedRig, instants, ready_rig

TIMEOUT_S = 3.0
REHEARSED = ("clock=real", f"can.heartbeat.timeout_ms={1000 * TIMEOUT_S:.0f}")


@pytest.fixture(name="opened")
def _opened() -> Iterator[OpenedRig]:
    with ready_rig(*REHEARSED) as opened:
        yield opened


def test_a_move_takes_the_time_that_it_takes_on_a_bench(opened: OpenedRig) -> None:
    """5 mm at 10 mm/s and 50 mm/s2: 0.5 s and the ramps, by another clock."""
    clock = SystemClock()
    opened.rig.axis("linear").start_move(5.0, 10.0)
    while not opened.rig.read_states()["linear"].target_reached:
        opened.rig.wait(0.02)
    assert 0.7 <= clock.now_s() < TIMEOUT_S
    assert opened.rig.read_states()["linear"].position == pytest.approx(5.0, abs=0.01)


def test_a_picture_has_the_time_at_which_the_axes_stood_as_it_shows(opened: OpenedRig) -> None:
    """While an axis moves, its time lies within the call, and it is known by far less than a period."""
    opened.rig.axis("linear").start_move(20.0, 5.0)
    before_s = opened.rig.clock.now_s()
    frame = opened.rig.camera.capture()
    assert before_s <= frame.t_s <= opened.rig.clock.now_s()
    assert frame.t_bound_s is not None
    assert frame.t_bound_s < 0.1  # on a busy machine


def test_a_labrig_that_hangs_stops_the_drives(opened: OpenedRig) -> None:
    """Time passes for the drives while labrig does nothing: they miss its heartbeat, as on a bench."""
    opened.rig.axis("linear").start_move(100.0, 5.0)
    opened.rig.wait(0.1)
    SystemClock().sleep(TIMEOUT_S + 0.5)
    with pytest.raises(DriveError):
        opened.rig.wait(1.0)
    assert instants(opened.drives["linear"], "emergency 0x8130")
