"""Where each axis has to be: the judgement alone, and the rig that stops by it."""

import math

import pytest

from labrig.devices.axis import Axis
from labrig.devices.position_supervision import (
    AT_REST,
    Expected,
    PositionReading,
    PositionWatch,
    expect_move,
    expect_rest,
)
from labrig.devices.trapezoid import Limits, make_move_profile
from labrig.errors import POSITION_JUMPED, STRAYED, DriveStrayedError
from tests.devices.rigs import OpenedRig, epos2_axis, one_drive, ready_rig

AXIS = epos2_axis()
WINDOW, LAG = AXIS.position_window, AXIS.max_following_error
PROFILE = make_move_profile(1.0, 0.0, 0.0, 24.0, Limits(5.0, AXIS.acceleration, AXIS.acceleration))
MOVE = Expected(PROFILE, speed=5.0)


def judge(
    expected: Expected | None, *positions: float, start_s: float = 0.0, step_s: float = 0.01
) -> DriveStrayedError | None:
    """Return the error of the last of these readings."""
    with one_drive() as bench:
        axis, error = Axis("insertion", AXIS, bench.driver, bench.clock), None
    axis.expected = expected
    for number, position in enumerate(positions):
        t_s = start_s + number * step_s
        error = axis.judge(PositionReading(t_s, t_s, position))
    return error


def on_profile(t_s: float) -> float:
    """Return where the profile is."""
    return PROFILE.at(t_s)[0]


@pytest.mark.parametrize("t_s", [0.0, 1.0, 1.05, 2.0, 5.0, 5.9, 10.0])
@pytest.mark.parametrize("late_s", [-0.04, 0.0, 0.04])
def test_an_axis_on_its_profile_raises_no_alarm(t_s: float, late_s: float) -> None:
    """Also one that is a drive's cycle early or late, or lags by less than the following error."""
    assert judge(MOVE, on_profile(t_s - late_s), start_s=t_s) is None
    assert judge(MOVE, max(0.0, on_profile(t_s) - 0.9 * LAG), start_s=t_s) is None


@pytest.mark.parametrize(
    ("t_s", "position"),
    [
        (0.5, -3 * WINDOW),
        (3.0, on_profile(3.0) + LAG + 0.3),
        (3.0, on_profile(3.0) - LAG - 0.3),
        (9.0, 24.0 + 3 * WINDOW),
        (9.0, 24.0 - LAG - WINDOW),
    ],
)
def test_an_axis_beside_its_profile_has_strayed(t_s: float, position: float) -> None:
    """Behind its start, ahead, behind, beyond its target, short of it; the message says where it should be and is."""
    error = judge(MOVE, position, start_s=t_s)
    assert error is not None
    assert error.fault is STRAYED
    assert "axis insertion should be between" in error.message
    assert f"on its way to 24.0000 mm, and is at {position:.4f} mm" in error.message


def test_what_the_computer_does_not_know_of_the_time_blames_no_axis() -> None:
    """A drive that may have begun earlier is ahead, and a reading of unknown time is judged by both its instants."""
    assert judge(Expected(PROFILE, 0.5, speed=5.0), on_profile(2.0 + 0.5), start_s=2.0) is None
    assert judge(MOVE, on_profile(2.0 + 0.5), start_s=2.0) is not None
    reading = PositionReading(2.0, 3.0, on_profile(2.5))
    assert PositionWatch("insertion", AXIS).judge(MOVE, None, reading) is None


def test_an_axis_at_rest_stays_where_it_was() -> None:
    """Where it was first read, or at the target where it arrived; within two windows, and no further by creeping."""
    assert judge(AT_REST, 7.0, 7.0 + WINDOW, 7.0 - WINDOW) is None
    assert judge(expect_rest(7.0), 7.0 - WINDOW, 7.0 - 2 * WINDOW) is None
    error = judge(AT_REST, 7.0, 7.0 + 2 * WINDOW, 7.0 + 3 * WINDOW)
    assert error is not None
    assert error.message == "axis insertion should stand at 7.0000 mm, and is at 7.0150 mm"


def test_a_servo_may_dither_however_small_its_window_is() -> None:
    """Two counts to either side are no motion."""
    watch = PositionWatch("insertion", AXIS.model_copy(update={"position_window": 1e-6}))
    at_rest = expect_rest(7.0)
    for position in (7.0, 7.0 + 2 / 4000, 7.0 - 2 / 4000):
        assert watch.judge(at_rest, None, PositionReading(0.0, 0.0, position)) is None


def test_a_jump_is_told_from_motion() -> None:
    """What no motor can do is the encoder's; what one can do is motion."""
    jump = judge(AT_REST, 7.0, 7.5)
    assert jump is not None
    assert jump.fault is POSITION_JUMPED
    assert "jumped from 7 to 7.5 mm within 0.010 s, faster than the axis can move (20 mm/s)" in jump.message
    motion = judge(AT_REST, 7.0, 7.1)
    assert motion is not None
    assert motion.fault is STRAYED


def test_an_axis_at_its_greatest_speed_has_a_drives_cycle_of_margin() -> None:
    """A reading that the drive made a little early, and the next a little late, are motion; a leap is none."""
    fast = Expected(
        make_move_profile(1.0, 0.0, 0.0, 60.0, Limits(AXIS.max_speed, AXIS.acceleration, AXIS.acceleration)),
        speed=AXIS.max_speed,
    )
    early, late = (fast.profile.at(t_s)[0] for t_s in (1.98, 2.22))
    assert late - early > AXIS.max_speed * 0.2 + 2 * WINDOW
    assert judge(fast, early, late, start_s=2.0, step_s=0.2) is None
    leap = judge(fast, early, late + 1.0, start_s=2.0, step_s=0.2)
    assert leap is not None
    assert leap.fault is POSITION_JUMPED


def test_nothing_is_expected_of_an_axis_that_homes() -> None:
    """Nobody can tell where it has to be."""
    assert judge(None, 7.0, 9.0, -3.0) is None


def test_a_move_that_replaces_another_goes_on_from_where_the_axis_is() -> None:
    """Onwards at the same speed, and back: the axis brakes first."""
    for target in (30.0, 0.0):
        here = on_profile(3.0)
        replaced = expect_move(AXIS, MOVE, here, (target, 5.0), (2.99, 3.0))
        went = make_move_profile(2.995, here, 5.0, target, Limits(5.0, AXIS.acceleration, AXIS.acceleration))
        for t_s in (3.0, 3.05, 3.1, 3.2, 3.5, 5.0, 20.0):
            assert judge(replaced, went.at(t_s)[0], start_s=t_s) is None
    assert replaced.profile.end_position == 0.0


# On the rig


def arrive(opened: OpenedRig, axis: Axis) -> None:
    """Wait until a move is done."""
    while not opened.rig.read_states()[axis.name].target_reached:
        opened.rig.wait(0.02)


def test_what_labrig_does_itself_raises_no_alarm() -> None:
    """A backlash taken up, a target changed on the way, a stop, a jog and a homing."""
    with ready_rig("axes.insertion.backlash=0.2") as opened:
        rig, insertion = opened.rig, opened.rig.axis("insertion")
        for position, speed in ((10.0, 5.0), (14.0, 2.0), (3.0, 10.0)):
            insertion.start_move(position, speed)
            rig.wait(1.0)
        arrive(opened, insertion)
        insertion.start_move(20.0, 5.0)
        rig.wait(0.5)
        rig.stop()
        rig.wait(1.0)
        rig.read_states()
        insertion.start_jog(-1.0, 1.0)
        arrive(opened, insertion)
        rig.reference_axes()
        rig.wait(1.0)
        rig.assume_positions({"rotation": 1.0})
        rig.wait(1.0)
        rig.axis("rotation").start_move(0.0, math.pi)
        arrive(opened, rig.axis("rotation"))
