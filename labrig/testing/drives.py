"""Tests of every drive: it verifies, holds, moves, and stops by itself when the computer falls silent.

On real hardware the axis moves by `OpenedDrive.distance` to both sides of its position. Clear its travel, remove the
needle, and keep a hand on the emergency stop.
"""

import json
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import dataclass, field

from labrig.clock import Clock
from labrig.devices.axis_description import AxisDescription
from labrig.devices.bus import CanLink
from labrig.devices.can_description import HeartbeatDescription
from labrig.devices.clocks import SimulatedClock
from labrig.devices.driver_section import find_section
from labrig.devices.drives.drive import STILL_POLL_S, Drive, Homing
from labrig.devices.drives.section import ProductSection
from labrig.devices.drives.states import DriveState, decode_state
from labrig.devices.heartbeat import HeartbeatClock
from labrig.devices.simulated.bus import InProcessWire, attach
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
        self.drive: Drive = self.section.open(self.link, "tested", self.clock)
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

    def wait(self, turns: Iterator[None]) -> None:
        """Let rig time pass until a homing or a stop has ended."""
        for _ in turns:
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
        self.wait(self.drive.home(Homing(position=position)))
        assert self.drive.is_referenced()
        assert self.is_at(position)


@contextmanager
def simulated_drive(
    driver: str, node_id: int = 1, section: ProductSection | None = None
) -> Iterator[OpenedDrive]:
    """Put the simulated drive of a kind on a bus inside the process; the default is its example section."""
    clock, wire = SimulatedClock(), InProcessWire()
    section = section or find_section(DRIVES, driver, ProductSection).example(node_id)
    link = attach(wire, clock, _ANSWER_TIMEOUT_S)
    node = section.simulate(wire, clock, Mechanics())
    clock.on_advance(node.tick)
    yield OpenedDrive(link, section, clock)
    link.close()
    node.unplug()


class DriveConformance:
    """Tests of a kind of drive; a subclass opens one."""

    def open_drive(self) -> AbstractContextManager[OpenedDrive]:
        """Open the bus of the drive; each test opens it again."""
        raise NotImplementedError

    @contextmanager
    def _enabled(self) -> Iterator[OpenedDrive]:
        with self.open_drive() as bench:
            bench.drive.identify()
            bench.drive.configure(bench.heartbeat, None)
            bench.drive.enable()
            yield bench
            bench.drive.close()

    def test_identifying_writes_nothing_and_configuring_gives_no_power(self) -> None:
        """Identity and settings are ready for the record; reading for a move is refused without power."""
        with self.open_drive() as bench:
            drive = bench.drive
            identity = drive.identify()
            assert identity.model
            frames = bench.link.network.take_frames()
            sent = [data for _, can_id, data, way in frames if way == "T" and 0x600 < can_id < 0x680]
            assert all(data[0] == 0x40 for data in sent)
            drive.configure(bench.heartbeat, None)
            assert json.dumps([identity.document(), drive.describe()])
            assert _refuses(drive.read)

    def test_enabling_moves_nothing_and_moves_arrive_in_the_window(self) -> None:
        """Target and position are the rounded ones, forwards, back, and after a move that is replaced on its way."""
        with self._enabled() as bench:
            start = bench.drive.position()
            bench.clock.sleep(0.2)
            assert bench.is_at(start)
            assert decode_state(bench.drive.read().statusword) is DriveState.OPERATION_ENABLED
            assert bench.drive.faults() == ()
            bench.drive.check()
            for target in (start + bench.distance, start):
                rounded = bench.drive.round_move(target, bench.speed)
                assert rounded.sent
                assert abs(rounded.position - target) <= bench.window
                bench.move_to(target)
                assert bench.drive.target() in {None, rounded.position}
            bench.move_to(bench.start_moving())

    def test_a_report_at_a_sync_has_position_and_load(self) -> None:
        """The position is that of a read by SDO; current and inputs are there, as far as the drive has them."""
        with self._enabled() as bench:
            since_s = bench.clock.now_s()
            bench.link.send(_SYNC, b"")
            reported, lag = bench.drive.read(since_s), bench.drive.lag()
            assert bench.is_at(reported.position)
            assert (reported.current_ma is None) is (bench.drive.current_ma() is None)
            assert set(reported.inputs) == set(bench.section.inputs) == set(bench.drive.read_inputs())
            assert lag is None or abs(lag) <= bench.section.max_following_error

    def test_every_stop_ends_a_move(self) -> None:
        """One that is only sent and one that is answered keep power; after a quick stop the drive must be enabled."""
        with self._enabled() as bench:
            for stop, is_quick in (
                (bench.drive.post_stop, False),
                (bench.drive.stop, False),
                (bench.drive.stop, True),
            ):
                start = bench.start_moving()
                assert _refuses(lambda: bench.wait(bench.drive.wait_until_still(0.0)))
                stop(quick=is_quick)
                bench.wait(bench.drive.wait_until_still(_TIMEOUT_S))
                assert _refuses(bench.drive.read) is is_quick
                if is_quick:
                    bench.drive.enable()
                bench.move_to(start)

    def test_positions_count_from_where_it_was_homed_or_is_assumed(self) -> None:
        """Nothing moves by either; only homing gives a reference."""
        with self._enabled() as bench:
            bench.drive.assume_position(40 * bench.window)
            assert bench.is_at(40 * bench.window)
            bench.move_to(0.0)
            bench.home_here(2 * bench.distance)
            bench.home_here(0.0)

    def test_the_drive_itself_holds_the_limits(self) -> None:
        """A target beyond them is not reached, whatever the computer commands."""
        with self._enabled() as bench:
            bench.home_here(0.0)
            near, far = bench.distance / 4, bench.distance
            bench.drive.set_limits((-near, near))
            with suppress(DriveError):
                bench.drive.start_move(far, bench.speed / 4)
                bench.clock.sleep(4 * far / bench.speed + 1)
            bench.wait(bench.drive.wait_until_still(_TIMEOUT_S))
            assert bench.drive.position() < far / 2
            bench.drive.reset_fault()
            bench.drive.set_limits(None)
            bench.drive.enable()
            bench.move_to(0.0)

    def test_the_drive_stops_when_the_computer_falls_silent(self) -> None:
        """Without heartbeats it stops by itself, reports why, and moves only after its fault has been reset."""
        with self._enabled() as bench:
            # A drive misses only a heartbeat that it has received before.
            bench.clock.sleep(2 * bench.heartbeat.period_ms / 1000)
            start = bench.drive.position()
            bench.drive.start_move(start + bench.distance, bench.speed / 100)
            bench.silent_clock.sleep(2 * bench.heartbeat.timeout_ms / 1000)
            bench.wait(bench.drive.wait_until_still(_TIMEOUT_S))
            assert bench.drive.faults()
            assert _refuses(bench.drive.read)
            assert _refuses(bench.drive.enable)
            bench.drive.reset_fault()
            assert bench.drive.faults() == ()
            bench.drive.enable()
            bench.move_to(start)

    def test_closing_leaves_no_fault_and_restores_the_current_limit(self) -> None:
        """Power and both heartbeats end; a limit holds until then, and a drive without one refuses it."""
        with self.open_drive() as bench:
            drive = bench.drive
            own_ma = drive.current_limit_ma()
            if own_ma is None:
                assert _refuses(lambda: drive.configure(bench.heartbeat, 1))
                return
            drive.configure(bench.heartbeat, own_ma // 2)
            limit_ma = drive.current_limit_ma()
            assert limit_ma is not None
            assert 0.9 * (own_ma // 2) < limit_ma <= own_ma // 2 + 1
            drive.close()
            assert drive.current_limit_ma() == own_ma
            bench.silent_clock.sleep(2 * bench.heartbeat.timeout_ms / 1000)
            assert drive.faults() == ()
            assert _refuses(drive.read)


def _refuses(act: Callable[[], object]) -> bool:
    """Tell whether something raises `DriveError`."""
    try:
        act()
    except DriveError:
        return True
    return False
