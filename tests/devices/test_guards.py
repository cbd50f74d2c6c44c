"""What stops an axis: a current limit, a stall, an input, a position where it cannot be; judged alone and on a rig."""

import math
from contextlib import nullcontext
from pathlib import Path

import pytest

from labrig.devices.axis import Axis
from labrig.devices.input_channel import InputChannel, InputValue
from labrig.devices.needle_state import NeedleState
from labrig.devices.opening import Opening
from labrig.devices.position_supervision import (
    AT_REST,
    Expected,
    PositionReading,
    PositionWatch,
    expect_move,
    expect_rest,
)
from labrig.devices.stall import StallWatch
from labrig.devices.trapezoid import Limits, make_move_profile
from labrig.errors import DriveError, ForceGuardError
from tests.devices import epos2_places as od
from tests.devices.rigs import (
    OpenedRig,
    epos2_axis,
    instants,
    make_rig,
    one_drive,
    opened_rig,
    ready_rig,
    simulated_rig,
)

LIMIT = "axes.linear.max_current_ma=800"


def _limit_of(opened: OpenedRig) -> int:
    """Return the current limit in the drive [mA]."""
    return opened.drives["linear"].objects.value(od.CURRENT_LIMIT)


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("max_current_ma=25000", ""),
        ("max_current_ma=25001", "has a limit of 25000, the rig file says max_current_ma 25001"),
        ("max_speed=10.4", ""),
        ("max_speed=10.5", r"has a limit of 10\.4167, the rig file says max_speed 10\.5"),
    ],
)
def test_a_limit_above_that_of_the_drive_is_refused_with_both(override: str, words: str) -> None:
    """Of its current, and of the speed of its motor; nothing has been switched on."""
    with opened_rig(simulated_rig(f"axes.linear.{override}")) as opened:
        if "speed" in override:
            opened.drives["linear"].objects.put(od.MAX_MOTOR_SPEED, 500)
        with pytest.raises(DriveError, match=words) if words else nullcontext():
            opened.rig.connect()
        assert opened.drives["linear"].is_powered() is (words == "")


def test_the_limit_that_a_killed_labrig_left_is_no_limit_of_the_drive(tmp_path: Path) -> None:
    """The next opening gives the drive its own limit again, so that neither refusal nor closing takes it for that.

    The lower one of rig file and opening holds: a protocol or a jog can only ask for less.
    """
    opening = Opening(camera=False, max_current_ma={"linear": 300})
    with opened_rig(simulated_rig(LIMIT), opening=opening) as opened:
        opened.rig.needle = NeedleState(tmp_path / "state.json")
        opened.rig.connect()
        assert _limit_of(opened) == 300  # and nobody closes that rig
        opened.drives["linear"].objects.values |= dict.fromkeys(od.CONFIGURATION, 7)
        asks_for_more = Opening(camera=False, max_current_ma={"linear": 2000})
        rig = make_rig(opened.rig.description, opened.hardware, asks_for_more)
        rig.needle = NeedleState(tmp_path / "state.json")
        rig.connect()
        assert _limit_of(opened) == 800
        assert [opened.drives["linear"].objects.value(place) for place in od.CONFIGURATION] == [7, 7]
        rig.close()
        assert _limit_of(opened) == 25_000
        assert not rig.state.current_limits


def test_an_input_that_the_drive_hides_is_refused() -> None:
    """An EPOS2 masks general-D to general-F as it comes: they would read off whatever is wired to them."""
    hidden = simulated_rig("axes.linear.inputs={door: {source: general-D, expected: false}}")
    with opened_rig(hidden) as opened:
        with pytest.raises(DriveError, match=r"hides its input general-D.*0xe387, without bit 12"):
            opened.rig.connect()
        opened.drives["linear"].objects.values[od.INPUT_MASK] = 0xF387
        make_rig(hidden, opened.hardware, Opening(camera=False)).connect()


FORCE = InputChannel(source="analog-1", unit="N", units_per_volt=4.0, zero_v=0.5, limits=(-5.0, 5.0))
SHUT = InputChannel(source="general-A", expected=True)


@pytest.mark.parametrize(
    ("channel", "value", "words"),
    [
        (FORCE, 5.0, ""),
        (FORCE, -5.0, ""),
        (FORCE, 5.01, "input x is 5.01 N, limits [-5, 5] N (analog-1 of the drive of axis linear)"),
        (FORCE, -5.01, "input x is -5.01 N, limits [-5, 5] N"),
        (FORCE, math.nan, "input x is nan N"),
        (SHUT, True, ""),
        (SHUT, False, "input x is off, expected on (general-A of the drive of axis linear)"),
        (SHUT.model_copy(update={"expected": None}), False, ""),
    ],
)
def test_an_input_beyond_its_limit_is_an_error(channel: InputChannel, value: InputValue, words: str) -> None:
    """At the limit a run goes on; the error says what reads what, and where it is wired."""
    error = channel.find_excess("x", "linear", value)
    assert (error is None) is (words == "")
    assert error is None or error.message.startswith(words)


@pytest.mark.parametrize(("speed", "told_within_s"), [(1.0, 0.5), (5.0, 0.1), (20.0, 0.025)])
def test_a_blocked_axis_is_stopped_before_its_drive_fails(speed: float, told_within_s: float) -> None:
    """The drive itself would fail 0.5 mm behind: after 0.5, 0.1 and 0.025 s."""
    with ready_rig(LIMIT, moves=("linear", 90.0, speed)) as opened:
        opened.drives["linear"].shaft.jam()
        blocked_s = opened.hardware.clock.now_s()
        with pytest.raises(ForceGuardError, match="the linear axis is stalled: 800 mA for"):
            opened.rig.wait(2.0)
        stopped_s = next(t_s for t_s in instants(opened.drives["linear"], "brake") if t_s >= blocked_s)
        assert stopped_s - blocked_s < told_within_s
        # From 20 mm/s it brakes over a whole millimetre, and its drive fails on the way.
        assert bool(opened.rig.axis("linear").drive.fault()) is (speed > 5)


@pytest.mark.parametrize(
    ("readings", "told"),
    [
        ([(1.0, 0.9, 400.0), (1.3, 1.0, -400.0)], "the linear axis is stalled: 400 mA for 0.30 s, 1 mm behind"),
        ([(1.0, 0.9, 399.0), (1.3, 1.2, 480.0)], ""),
        ([(1.0, 1.2, 480.0)], ""),
        ([(1.0, 0.9, 480.0), (1.1, 1.2, 399.0)], ""),
        ([(1.0, 0.4, -480.0), (1.1, 0.99, -480.0)], ""),
        ([(1.0, 1.2, 480.0), (1.1, 1.2, 100.0), (1.2, 1.2, 480.0)], ""),
    ],
    ids=["stall", "current rises", "one reading", "current falls", "small lag", "current falls in between"],
)  # fmt: skip
def test_a_stall_is_current_and_lag_in_two_readings(
    readings: list[tuple[float, float, float]], told: str
) -> None:
    """0.8 of the limit, half the lag at which the drive would fail; one of them alone, or once, is no stall."""
    messages = []
    with one_drive() as bench:
        axis = Axis("linear", epos2_axis(max_following_error=2.0), bench.driver, bench.clock)
        watch = StallWatch(axis, 500)
        for reading in readings:
            try:
                watch.judge(*reading)
            except ForceGuardError as error:
                messages.append(error.message)
    assert messages == [told] * bool(told)


AXIS = epos2_axis()
WINDOW, LAG = AXIS.position_window, AXIS.max_following_error
LIMITS = Limits(5.0, AXIS.acceleration, AXIS.acceleration)
PROFILE = make_move_profile(1.0, 0.0, 0.0, 24.0, LIMITS)
MOVE = Expected(PROFILE, speed=5.0)


def _tell(expected: Expected | None, *positions: float, start_s: float = 0.0, step_s: float = 0.01) -> str:
    """Return the fault and the message of the last of these readings; empty without one."""
    with one_drive() as bench:
        axis, error = Axis("insertion", AXIS, bench.driver, bench.clock), None
    axis.expected = expected
    for number, position in enumerate(positions):
        t_s = start_s + number * step_s
        error = axis.judge(PositionReading(t_s, t_s, position))
    return "" if error is None or error.fault is None else f"{error.fault.name}: {error.message}"


def _on_profile(t_s: float) -> float:
    return PROFILE.at(t_s)[0]


@pytest.mark.parametrize("t_s", [0.0, 1.0, 1.05, 2.0, 5.0, 5.9, 10.0])
@pytest.mark.parametrize("late_s", [-0.04, 0.0, 0.04])
def test_an_axis_on_its_profile_raises_no_alarm(t_s: float, late_s: float) -> None:
    """Also one that is a drive's cycle early or late, or lags by less than the following error."""
    assert _tell(MOVE, _on_profile(t_s - late_s), start_s=t_s) == ""
    assert _tell(MOVE, max(0.0, _on_profile(t_s) - 0.9 * LAG), start_s=t_s) == ""


@pytest.mark.parametrize(
    ("t_s", "position"),
    [
        (0.5, -3 * WINDOW), (3.0, _on_profile(3.0) + LAG + 0.3), (3.0, _on_profile(3.0) - LAG - 0.3),
        (9.0, 24.0 + 3 * WINDOW), (9.0, 24.0 - LAG - WINDOW),
    ],
)  # fmt: skip
def test_an_axis_beside_its_profile_has_strayed(t_s: float, position: float) -> None:
    """Behind its start, ahead, behind, beyond its target, short of it; the message says where it should be and is."""
    told = _tell(MOVE, position, start_s=t_s)
    assert told.startswith("strayed: axis insertion should be between")
    assert f"on its way to 24.0000 mm, and is at {position:.4f} mm" in told


def test_what_the_computer_does_not_know_of_the_time_blames_no_axis() -> None:
    """A drive that may have begun earlier is ahead, and a reading of unknown time is judged by both its instants."""
    ahead = _on_profile(2.0 + 0.5)
    assert _tell(Expected(PROFILE, 0.5, speed=5.0), ahead, start_s=2.0) == ""
    assert _tell(MOVE, ahead, start_s=2.0).startswith("strayed")
    assert PositionWatch("insertion", AXIS).judge(MOVE, None, PositionReading(2.0, 3.0, ahead)) is None


def test_an_axis_at_rest_stays_where_it_was() -> None:
    """Where it was first read, or at the target where it arrived; within two windows, and no further by creeping.

    Two counts to either side are no motion, however small the window is; what homes can be anywhere.
    """
    assert _tell(AT_REST, 7.0, 7.0 + WINDOW, 7.0 - WINDOW) == ""
    assert _tell(expect_rest(7.0), 7.0 - WINDOW, 7.0 - 2 * WINDOW) == ""
    crept = _tell(AT_REST, 7.0, 7.0 + 2 * WINDOW, 7.0 + 3 * WINDOW)
    assert crept == "strayed: axis insertion should stand at 7.0000 mm, and is at 7.0150 mm"
    narrow = PositionWatch("insertion", AXIS.model_copy(update={"position_window": 1e-6}))
    for counts, is_still in ((2, True), (-2, True), (5, False)):
        reading = PositionReading(0.0, 0.0, 7.0 + counts / 4000)
        assert (narrow.judge(expect_rest(7.0), None, reading) is None) is is_still
    assert _tell(None, 7.0, 9.0, -3.0) == ""


def test_a_jump_is_told_from_motion() -> None:
    """What no motor can do is the encoder's; what one can do is motion, at any speed."""
    jumped = "position-jump: the position of axis insertion jumped from 7 to 7.5 mm within 0.010 s, faster than the"
    assert _tell(AT_REST, 7.0, 7.5).startswith(f"{jumped} axis can move (20 mm/s)")
    assert _tell(AT_REST, 7.0, 7.1).startswith("strayed")
    limits = Limits(AXIS.max_speed, AXIS.acceleration, AXIS.acceleration)
    fast = Expected(make_move_profile(1.0, 0.0, 0.0, 60.0, limits), speed=AXIS.max_speed)
    early, late = (fast.profile.at(t_s)[0] for t_s in (1.98, 2.22))
    assert late - early > AXIS.max_speed * 0.2 + 2 * WINDOW
    assert _tell(fast, early, late, start_s=2.0, step_s=0.2) == ""
    assert _tell(fast, early, late + 1.0, start_s=2.0, step_s=0.2).startswith("position-jump")


def test_a_move_that_replaces_another_goes_on_from_where_the_axis_is() -> None:
    """Onwards at the same speed, and back: the axis brakes first."""
    for target in (30.0, 0.0):
        here = _on_profile(3.0)
        replaced = expect_move(AXIS, MOVE, here, (target, 5.0), (2.99, 3.0))
        went = make_move_profile(2.995, here, 5.0, target, LIMITS)
        for t_s in (3.0, 3.05, 3.1, 3.2, 3.5, 5.0, 20.0):
            assert _tell(replaced, went.at(t_s)[0], start_s=t_s) == ""
    assert replaced.profile.end_position == 0.0
