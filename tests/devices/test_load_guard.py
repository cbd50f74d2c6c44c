"""Current limits, stalls and inputs: on an opened rig, and what a stall is."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from labrig.devices.axis import Axis
from labrig.devices.input_channel import InputChannel
from labrig.devices.needle_state import NeedleState
from labrig.devices.opening import Opening
from labrig.devices.position_supervision import Expected
from labrig.devices.rig import Rig
from labrig.devices.stall import StallWatch
from labrig.devices.trapezoid import make_rest_profile
from labrig.errors import DriveError, FileFormatError, ForceGuardError
from tests.devices import epos2_places as od
from tests.devices.rigs import (
    OpenedRig,
    Person,
    epos2_axis,
    instants,
    one_drive,
    opened_rig,
    ready_rig,
    simulated_rig,
)

LIMIT = "axes.linear.max_current_ma=800"


def limit_of(opened: OpenedRig, axis: str = "linear") -> int:
    """Return the current limit in a drive [mA]."""
    return opened.drives[axis].objects.value(od.CURRENT_LIMIT)


def open_again(opened: OpenedRig, opening: Opening | None = None, needle: NeedleState | None = None) -> Rig:
    """Return another rig over the same hardware, not yet connected."""
    rig = Rig(
        opened.rig.description,
        hardware=opened.hardware,
        link=opened.hardware.open_link(),
        source=None,
        person=Person(),
        interrupted=lambda: None,
        opening=opening or Opening(camera=False),
    )
    rig.needle = needle or rig.needle
    return rig


def go_on(rig: Rig) -> None:
    """Wait and read states as a run does, for 2 s."""
    for _ in range(20):
        rig.wait(0.1)
        rig.read_states()


@pytest.mark.parametrize(("given_ma", "in_force_ma"), [(500, 500), (2000, 800)])
def test_the_lower_limit_of_rig_file_and_opening_holds(given_ma: int, in_force_ma: int) -> None:
    """A protocol or a jog can only ask for less."""
    with opened_rig(simulated_rig(LIMIT)) as opened:
        open_again(opened, Opening(camera=False, max_current_ma={"linear": given_ma})).connect()
        assert limit_of(opened) == in_force_ma


@pytest.mark.parametrize(
    ("override", "words"),
    [
        (
            "axes.linear.max_current_ma=26000",
            "has a limit of 25000, the rig file says max_current_ma 26000",
        ),
        ("axes.linear.max_speed=20", r"has a limit of 10\.4167, the rig file says max_speed 20"),
    ],
)
def test_a_limit_above_that_of_the_drive_is_refused_with_both(override: str, words: str) -> None:
    """Of its current, and of the speed of its motor; nothing has been switched on."""
    with opened_rig(simulated_rig(override)) as opened:
        if "speed" in override:
            opened.drives["linear"].objects.put(od.MAX_MOTOR_SPEED, 500)
        with pytest.raises(DriveError, match=words):
            opened.rig.connect()
        assert not any(drive.is_powered() for drive in opened.drives.values())


def test_the_limit_that_a_killed_labrig_left_is_no_limit_of_the_drive(tmp_path: Path) -> None:
    """The next opening gives the drive its own limit again, so that neither refusal nor closing takes it for that."""
    state = NeedleState(tmp_path / "state.json")
    with opened_rig(simulated_rig(LIMIT)) as opened:
        open_again(opened, Opening(camera=False, max_current_ma={"linear": 300}), state).connect()
        assert limit_of(opened) == 300  # and nobody closes that rig
        opened.drives["linear"].objects.values |= dict.fromkeys(od.CONFIGURATION, 7)
        rig = open_again(opened, needle=NeedleState(tmp_path / "state.json"))
        rig.connect()
        assert limit_of(opened) == 800
        assert [opened.drives["linear"].objects.value(place) for place in od.CONFIGURATION] == [7, 7]
        rig.close()
        assert limit_of(opened) == 25_000
        assert not rig.state.current_limits


@pytest.mark.parametrize(("speed", "told_within_s"), [(1.0, 0.5), (5.0, 0.1), (20.0, 0.025)])
def test_a_blocked_axis_is_stopped_before_its_drive_fails(speed: float, told_within_s: float) -> None:
    """The drive itself would fail 0.5 mm behind: after 0.5, 0.1 and 0.025 s."""
    with ready_rig(LIMIT, moves=("linear", 90.0, speed)) as opened:
        opened.drives["linear"].shaft.jam()
        blocked_s = opened.hardware.clock.now_s()
        with pytest.raises(ForceGuardError, match="the linear axis is stalled: 800 mA for"):
            go_on(opened.rig)
        stopped_s = next(t_s for t_s in instants(opened.drives["linear"], "brake") if t_s >= blocked_s)
        assert stopped_s - blocked_s < told_within_s
        # From 20 mm/s it brakes over a whole millimetre, and its drive fails on the way.
        assert bool(opened.rig.axis("linear").drive.faults()) is (speed > 5)


def test_an_input_that_the_drive_hides_is_refused() -> None:
    """An EPOS2 masks general-D to general-F as it comes: they would read off whatever is wired to them."""
    hidden = simulated_rig("axes.linear.inputs={door: {source: general-D, expected: false}}")
    with opened_rig(hidden) as opened:
        with pytest.raises(DriveError, match=r"hides its input general-D.*0xe387, without bit 12"):
            opened.rig.connect()
        opened.drives["linear"].objects.values[od.INPUT_MASK] = 0xF387
        open_again(opened).connect()


# The judgement alone


@contextmanager
def watched(speed: float = 1.0) -> Iterator[StallWatch]:
    """Yield the watch on an axis in motion that may lag by 2 mm, with a limit of 500 mA."""
    with one_drive() as bench:
        axis = Axis("linear", epos2_axis(max_following_error=2.0), bench.driver, bench.clock)
        axis.expected = Expected(make_rest_profile(0.0, 0.0), speed=speed)
        yield StallWatch(axis, 500)


def judge(*readings: tuple[float, float, float]) -> str:
    """Return the message after readings (t_s, lag, current_ma); empty without an error."""
    with watched() as watch:
        try:
            for reading in readings:
                watch.judge(*reading)
        except ForceGuardError as error:
            assert reading is readings[-1]
            return error.message
    return ""


def test_a_stall_is_told_with_current_time_and_lag() -> None:
    """480 of 500 mA since the first reading, and 1.2 mm of the 2 mm at which the drive would fail."""
    assert judge((1.0, 0.9, 480.0), (1.3, 1.2, 480.0)) == (
        "the linear axis is stalled: 480 mA for 0.30 s, 1.2 mm behind"
    )


@pytest.mark.parametrize(
    "readings",
    [
        [(1.0, 1.2, 480.0)],
        [(1.0, 0.9, 480.0), (1.1, 1.2, 300.0)],
        [(1.0, 0.4, -480.0), (1.1, 0.9, -480.0)],
        [(1.0, 1.2, 480.0), (1.1, 1.2, 100.0), (1.2, 1.2, 480.0)],
    ],
    ids=["one reading", "current falls", "small lag", "current falls in between"],
)
def test_less_is_no_stall(readings: list[tuple[float, float, float]]) -> None:
    """One reading, a motor with current to spare, and an axis that follows are no stall."""
    assert judge(*readings) == ""


def test_a_fast_axis_is_looked_at_more_often() -> None:
    """Four times until the drive fails by its following error, but at most a hundred times a second."""
    for speed, period_s in ((2.0, 0.25), (100.0, 0.01)):
        with watched(speed) as watch:
            assert watch.period_s == pytest.approx(period_s)


# Channels at inputs


FORCE = InputChannel(source="analog-1", unit="N", units_per_volt=4.0, zero_v=0.5, limits=(-5.0, 5.0))
SHUT = InputChannel(source="general-A", expected=True)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("force: {source: analog-1, unit: N}", "units_per_volt is missing or zero for analog-1"),
        ("force: {source: analog-1, units_per_volt: 4}", "unit is missing or zero"),
        ("door: {source: general-A, limits: [0, 1]}", "general-A is a digital input"),
        ("force: {source: analog-1, unit: N, units_per_volt: 4, expected: true}", "is an analog input"),
        ("force: {source: analog-1, unit: N, units_per_volt: 4, limits: [5, -5]}", "the lower one first"),
        ("force: {source: analog-9, unit: N, units_per_volt: 4}", "analog-9 is no input of this drive"),
        ("Door: {source: general-A}", "Door"),
        ("shut: {source: general-A}", "input shut is also one of axis insertion"),
    ],
)
def test_a_rig_file_with_an_impossible_channel_is_refused(text: str, words: str) -> None:
    """Each problem names the key; two axes share no name of an input, by which records tell channels apart."""
    with pytest.raises(FileFormatError, match=words):
        simulated_rig(f"axes.linear.inputs={{{text}}}", "axes.insertion.inputs={shut: {source: general-A}}")
