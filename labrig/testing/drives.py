"""Tests of every drive: it verifies, holds, moves, and stops by itself when the computer falls silent.

On real hardware the axis moves by `OpenedDrive.distance` to both sides of its position. Clear its travel, remove the
needle, and keep a hand on the emergency stop.
"""

import json
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import dataclass, field

import pytest

from labrig.clock import Clock
from labrig.devices.axis_description import AxisDescription
from labrig.devices.bus import CanLink
from labrig.devices.can_description import HeartbeatDescription
from labrig.devices.clocks import SimulatedClock
from labrig.devices.driver_section import find_section
from labrig.devices.drives.cia402 import Cia402Drive
from labrig.devices.drives.drive import STILL_POLL_S, Homing
from labrig.devices.drives.states import DriveState, decode_state
from labrig.devices.heartbeat import HeartbeatClock
from labrig.devices.simulated.bus import InProcessWire, attach
from labrig.devices.simulated.cia402 import SimulatedCia402Drive
from labrig.devices.simulated.shaft import Mechanics
from labrig.errors import DriveError
from labrig.plugins import DRIVES

_ANSWER_TIMEOUT_S = 0.12
_POLL_S = 0.01
_TIMEOUT_S = 30.0
_SYNC = 0x080


@dataclass
class OpenedDrive:
    """A drive under test on its bus, opened by its section; every wait sends the computer's heartbeat, as a rig does.

    `silent_clock` lets time pass without a beat. `distance` is how far the axis may move to either side of its position
    [mm or rad].
    """

    link: CanLink
    section: AxisDescription
    silent_clock: Clock
    distance: float = 1.0
    heartbeat: HeartbeatDescription = field(default_factory=HeartbeatDescription)

    def __post_init__(self) -> None:
        self.clock = HeartbeatClock(self.silent_clock, self.link, self.heartbeat)
        self.drive = Cia402Drive(self.link, self.section, "tested", self.clock)
        self.speed = self.section.nearest_speed(self.section.max_speed / 2)
        self.window = self.section.position_window + 1 / self.section.scale().counts_per_unit

    def is_at(self, position: float) -> bool:
        """Tell whether the axis is within its window of a position."""
        return abs(self.drive.position() - position) <= self.window

    def wait_until(self, condition: Callable[[], bool]) -> None:
        """Let rig time pass until a condition holds."""
        deadline_s = self.clock.now_s() + _TIMEOUT_S
        while not condition():
            assert self.clock.now_s() < deadline_s, "it takes too long"
            self.clock.sleep(_POLL_S)

    def wait_until_still(self, within_s: float) -> None:
        """Wait until the axis stands still. Raises `DriveError` if it still moves after `within_s`."""
        for _ in self.drive.wait_until_still(within_s):
            self.clock.sleep(STILL_POLL_S)

    def move_to(self, position: float) -> None:
        """Move, and arrive."""
        self.drive.start_move(position, self.speed)
        self.wait_until(lambda: self.drive.read().target_reached)
        assert self.is_at(position)

    def start_moving(self) -> float:
        """Start a move forwards, wait until the axis has left its position, and return that position."""
        start = self.drive.position()
        self.drive.start_move(start + self.distance, self.speed / 4)
        self.wait_until(lambda: not self.is_at(start))
        return start

    def home_here(self, position: float) -> None:
        """Home at the present position."""
        for _ in self.drive.home(Homing(position=position)):
            self.clock.sleep(STILL_POLL_S)
        assert self.drive.is_referenced()
        assert self.is_at(position)


@contextmanager
def simulated_drive(
    driver: str, node_id: int = 1, section: AxisDescription | None = None
) -> Iterator[OpenedDrive]:
    """Put the simulated drive of a kind on a bus inside the process; the default is its example section."""
    clock, wire = SimulatedClock(), InProcessWire()
    section = section or find_section(DRIVES, driver, AxisDescription).example(node_id)
    link = attach(wire, clock, _ANSWER_TIMEOUT_S)
    node = SimulatedCia402Drive(section, wire, clock, Mechanics())
    clock.on_advance(node.tick)
    yield OpenedDrive(link, section, clock)
    link.close()
    node.unplug()


class DriveConformance:
    """Tests of a kind of drive; a subclass opens one."""

    def open_drive(self) -> AbstractContextManager[OpenedDrive]:
        """Open the bus of the drive; each test opens it again."""
        raise NotImplementedError

    @pytest.fixture
    def bench(self) -> Iterator[OpenedDrive]:
        """Open the bus of the drive."""
        with self.open_drive() as opened:
            yield opened

    @pytest.fixture
    def enabled(self, bench: OpenedDrive) -> Iterator[OpenedDrive]:
        """Identify, configure and enable the drive."""
        bench.drive.identify()
        bench.drive.configure(bench.heartbeat, None)
        bench.drive.enable()
        yield bench
        bench.drive.close()

    def test_identifying_writes_nothing_and_configuring_gives_no_power(self, bench: OpenedDrive) -> None:
        """Identity and settings are ready for the record; reading for a move is refused without power."""
        drive = bench.drive
        identity = drive.identify()
        assert identity.model
        frames = bench.link.network.take_frames()
        sent = [data for _, can_id, data, way in frames if way == "T" and 0x600 < can_id < 0x680]
        assert all(data[0] == 0x40 for data in sent)
        drive.configure(bench.heartbeat, None)
        assert json.dumps([identity.document(), drive.describe()])
        assert _refuses(drive.read)

    def test_enabling_moves_nothing_and_moves_arrive_in_the_window(self, enabled: OpenedDrive) -> None:
        """Target and position are the rounded ones, forwards, back, and after a move that is replaced on its way.

        What is reported at a SYNC has that position, and current and inputs as far as the drive has them.
        """
        start = enabled.drive.position()
        enabled.clock.sleep(0.2)
        assert enabled.is_at(start)
        assert decode_state(enabled.drive.read().statusword) is DriveState.OPERATION_ENABLED
        assert enabled.drive.fault() is None
        enabled.drive.check()
        for target in (start + enabled.distance, start):
            rounded = enabled.drive.round_move(target, enabled.speed)
            assert abs(rounded.position - target) <= enabled.window
            enabled.move_to(target)
            assert enabled.drive.target() == rounded.position
        enabled.move_to(enabled.start_moving())
        since_s = enabled.clock.now_s()
        enabled.link.send(_SYNC, b"")
        reported, lag = enabled.drive.read(since_s), enabled.drive.reports.lag()
        assert enabled.is_at(reported.position)
        assert (reported.current_ma is None) is (enabled.drive.reports.current_ma() is None)
        assert set(reported.inputs) == set(enabled.section.inputs) == set(enabled.drive.reports.read_inputs())
        assert lag is None or abs(lag) <= enabled.section.max_following_error

    def test_every_stop_ends_a_move(self, enabled: OpenedDrive) -> None:
        """One that is only sent and one that is answered keep power; after a quick stop the drive must be enabled."""
        for stop, is_quick in (
            (enabled.drive.post_stop, False),
            (enabled.drive.stop, False),
            (enabled.drive.stop, True),
        ):
            start = enabled.start_moving()
            assert _refuses(lambda: enabled.wait_until_still(0.0))
            stop(quick=is_quick)
            enabled.wait_until_still(_TIMEOUT_S)
            assert _refuses(enabled.drive.read) is is_quick
            if is_quick:
                enabled.drive.enable()
            enabled.move_to(start)

    def test_positions_count_from_where_it_was_homed_or_is_assumed(self, enabled: OpenedDrive) -> None:
        """Nothing moves by either; only homing gives a reference."""
        enabled.drive.assume_position(40 * enabled.window)
        assert enabled.is_at(40 * enabled.window)
        enabled.move_to(0.0)
        enabled.home_here(2 * enabled.distance)
        enabled.home_here(0.0)

    def test_the_drive_itself_holds_the_limits(self, enabled: OpenedDrive) -> None:
        """A target beyond them is not reached, whatever the computer commands."""
        enabled.home_here(0.0)
        near, far = enabled.distance / 4, enabled.distance
        enabled.drive.set_limits((-near, near))
        with suppress(DriveError):
            enabled.drive.start_move(far, enabled.speed / 4)
            enabled.clock.sleep(4 * far / enabled.speed + 1)
        enabled.wait_until_still(_TIMEOUT_S)
        assert enabled.drive.position() < far / 2
        enabled.drive.reset_fault()
        enabled.drive.set_limits(None)
        enabled.drive.enable()
        enabled.move_to(0.0)

    def test_the_drive_stops_when_the_computer_falls_silent(self, enabled: OpenedDrive) -> None:
        """Without heartbeats it stops by itself, reports why, and moves only after its fault has been reset."""
        # A drive misses only a heartbeat that it has received before.
        enabled.clock.sleep(2 * enabled.heartbeat.period_ms / 1000)
        start = enabled.drive.position()
        enabled.drive.start_move(start + enabled.distance, enabled.speed / 100)
        enabled.silent_clock.sleep(2 * enabled.heartbeat.timeout_ms / 1000)
        enabled.wait_until_still(_TIMEOUT_S)
        assert enabled.drive.fault()
        assert _refuses(enabled.drive.read)
        assert _refuses(enabled.drive.enable)
        enabled.drive.reset_fault()
        assert enabled.drive.fault() is None
        enabled.drive.enable()
        enabled.move_to(start)

    def test_closing_leaves_no_fault_and_restores_the_current_limit(self, bench: OpenedDrive) -> None:
        """Power and both heartbeats end; a limit holds until then, and a drive without one refuses it."""
        drive = bench.drive
        own_ma = drive.reports.current_limit_ma()
        if own_ma is None:
            assert _refuses(lambda: drive.configure(bench.heartbeat, 1))
            return
        drive.configure(bench.heartbeat, own_ma // 2)
        limit_ma = drive.reports.current_limit_ma()
        assert limit_ma is not None
        assert 0.9 * (own_ma // 2) < limit_ma <= own_ma // 2 + 1
        drive.close()
        assert drive.reports.current_limit_ma() == own_ma
        bench.silent_clock.sleep(2 * bench.heartbeat.timeout_ms / 1000)
        assert drive.fault() is None
        assert _refuses(drive.read)


def _refuses(act: Callable[[], object]) -> bool:
    """Tell whether something raises `DriveError`."""
    try:
        act()
    except DriveError:
        return True
    return False
