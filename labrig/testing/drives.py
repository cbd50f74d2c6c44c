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
from labrig.devices.drives.states import DriveState
from labrig.devices.heartbeat import HeartbeatClock
from labrig.devices.homing import HOMING_HERE
from labrig.devices.simulated.bus import InProcessWire, attach
from labrig.devices.simulated.shaft import Mechanics
from labrig.errors import DriveError
from labrig.plugins import DRIVES

_ANSWER_TIMEOUT_S = 0.12
_POLL_S = 0.01
_TIMEOUT_S = 30.0
_SYNC = 0x080


@dataclass(frozen=True)
class OpenedDrive:
    """A bus with a drive, its section of the rig file, and its clock.

    `distance` is how far the axis may move to either side of its position [mm or rad].
    """

    link: CanLink
    section: AxisDescription
    clock: Clock
    distance: float = 1.0
    heartbeat: HeartbeatDescription = field(default_factory=HeartbeatDescription)


@contextmanager
def simulated_drive(
    driver: str, node_id: int = 1, section: AxisDescription | None = None
) -> Iterator[OpenedDrive]:
    """Put the simulated drive of a kind on a bus inside the process; the default is its example section."""
    clock, wire = SimulatedClock(), InProcessWire()
    section = section or find_section(DRIVES, driver, AxisDescription).example(node_id)
    link = attach(wire, clock, _ANSWER_TIMEOUT_S)
    node = section.simulate(wire, clock, Mechanics())
    clock.on_advance(node.tick)
    yield OpenedDrive(link, section, clock)
    link.close()
    node.unplug()


class _Bench:
    """A drive under test; every wait sends the computer's heartbeat, as a rig does."""

    def __init__(self, opened: OpenedDrive) -> None:
        self.opened = opened
        self.clock = HeartbeatClock(opened.clock, opened.link, opened.heartbeat)
        self.drive: Drive = opened.section.open(opened.link, "tested", self.clock)
        scale = opened.section.scale()
        self.speed = scale.to_speed(scale.speed_units_below(opened.section.max_speed / 2))
        self.window = opened.section.position_window + 1 / scale.counts_per_unit

    def get_ready(self) -> None:
        """Configure and enable the drive."""
        self.drive.identify()
        self.drive.configure(self.opened.heartbeat, None)
        self.drive.enable()

    def wait_until(self, condition: Callable[[], bool]) -> None:
        """Let rig time pass until a condition holds."""
        deadline_s = self.clock.now_s() + _TIMEOUT_S
        while not condition():
            assert self.clock.now_s() < deadline_s, "it takes too long"
            self.clock.sleep(_POLL_S)

    def wait_until_still(self, within_s: float = _TIMEOUT_S) -> None:
        """Let rig time pass until the axis stands still."""
        for _ in self.drive.wait_until_still(within_s):
            self.clock.sleep(STILL_POLL_S)

    def move_to(self, position: float) -> None:
        """Move and wait for the end."""
        self.drive.start_move(position, self.speed)
        self.wait_until(lambda: self.drive.read().target_reached)

    def start_moving(self) -> float:
        """Start a move forwards, wait until the axis has left its position, and return that position."""
        start = self.drive.position()
        self.drive.start_move(start + self.opened.distance, self.speed / 4)
        self.wait_until(lambda: abs(self.drive.position() - start) > self.window)
        return start

    def home_here(self, position: float = 0.0) -> None:
        """Home at the present position."""
        homing = Homing(HOMING_HERE, position)
        for _ in self.drive.home(homing):
            self.clock.sleep(_POLL_S)


class DriveConformance:
    """Tests of a kind of drive; a subclass opens one."""

    def open_drive(self) -> AbstractContextManager[OpenedDrive]:
        """Open the bus of the drive; each test opens it again."""
        raise NotImplementedError

    @contextmanager
    def _bench(self) -> Iterator[_Bench]:
        with self.open_drive() as opened:
            yield _Bench(opened)

    @contextmanager
    def _ready(self) -> Iterator[_Bench]:
        with self._bench() as bench:
            bench.get_ready()
            yield bench
            bench.drive.close()

    def test_identifying_it_writes_nothing(self) -> None:
        """The drive reports model and versions; no object is written before it is configured."""
        with self._bench() as bench:
            identity = bench.drive.identify()
            assert identity.model
            assert json.dumps(identity.document())
            assert all(data[0] == 0x40 for data in _sent_requests(bench.opened.link))

    def test_power_is_off_after_configuring(self) -> None:
        """The settings are ready for the record; reading for a move is refused without power."""
        with self._bench() as bench:
            bench.drive.identify()
            bench.drive.configure(bench.opened.heartbeat, None)
            assert json.dumps(bench.drive.describe())
            assert _refuses(bench.drive.read)

    def test_enabling_moves_nothing(self) -> None:
        """The axis holds its position, and has no fault."""
        with self._ready() as bench:
            before = bench.drive.position()
            bench.clock.sleep(0.2)
            read = bench.drive.read()
            assert abs(read.position - before) <= bench.window
            assert read.state is DriveState.OPERATION_ENABLED
            assert bench.drive.faults() == ()
            bench.drive.check()

    def test_moves_arrive_in_the_window(self) -> None:
        """Forwards and back, the target in the drive and the position read are the rounded ones."""
        with self._ready() as bench:
            start = bench.drive.position()
            for target in (start + bench.opened.distance, start):
                rounded = bench.drive.round_move(target, bench.speed)
                assert rounded.sent
                assert abs(rounded.position - target) <= bench.window
                bench.move_to(target)
                assert bench.drive.target() in {None, rounded.position}
                assert abs(bench.drive.read().position - rounded.position) <= bench.window

    def test_a_move_can_be_replaced_on_its_way(self) -> None:
        """The axis ends at the second target, also backwards."""
        with self._ready() as bench:
            start = bench.start_moving()
            bench.move_to(start)
            assert abs(bench.drive.position() - start) <= bench.window

    def test_a_report_at_a_sync_has_position_and_load(self) -> None:
        """The position is that of a read by SDO; current and inputs are there, as far as the drive has them."""
        with self._ready() as bench:
            bench.drive.expect_report()
            bench.opened.link.send(_SYNC, b"")
            reported, lag = bench.drive.read(), bench.drive.lag()
            assert abs(reported.position - bench.drive.read().position) <= bench.window
            assert (reported.current_ma is None) is (bench.drive.current_ma() is None)
            assert set(reported.inputs) == set(bench.opened.section.inputs) == set(bench.drive.read_inputs())
            assert lag is None or abs(lag) <= bench.opened.section.max_following_error

    def test_stopping_holds_and_keeps_power(self) -> None:
        """After a stop that is only sent, and after one that is answered, the axis stands still and can move again."""
        with self._ready() as bench:
            for stop in (bench.drive.post_stop, bench.drive.stop):
                start = bench.start_moving()
                assert _refuses(lambda: bench.wait_until_still(0.0))
                stop()
                bench.wait_until_still()
                assert bench.drive.read().state is DriveState.OPERATION_ENABLED
                bench.move_to(start)

    def test_a_quick_stop_needs_enabling_again(self) -> None:
        """Until then the axis stands still and refuses to move."""
        with self._ready() as bench:
            start = bench.start_moving()
            bench.drive.stop(quick=True)
            bench.wait_until_still()
            assert _refuses(bench.drive.read)
            bench.drive.enable()
            bench.move_to(start)

    def test_positions_count_from_where_it_was_homed_or_is_assumed(self) -> None:
        """Nothing moves by either; only homing gives a reference."""
        with self._ready() as bench:
            bench.drive.assume_position(40 * bench.window)
            assert abs(bench.drive.position() - 40 * bench.window) <= bench.window
            bench.move_to(0.0)
            for home in (2 * bench.opened.distance, 0.0):
                bench.home_here(home)
                assert bench.drive.is_referenced()
                assert abs(bench.drive.position() - home) <= bench.window

    def test_the_drive_itself_holds_the_limits(self) -> None:
        """A target beyond them is not reached, whatever the computer commands."""
        with self._ready() as bench:
            bench.home_here()
            near = bench.opened.distance / 4
            bench.drive.set_limits((-near, near))
            with suppress(DriveError):
                bench.drive.start_move(bench.opened.distance, bench.speed / 4)
                bench.clock.sleep(4 * bench.opened.distance / bench.speed + 1)
            bench.wait_until_still()
            assert bench.drive.position() < bench.opened.distance / 2
            bench.drive.reset_fault()
            bench.drive.set_limits(None)
            bench.drive.enable()
            bench.move_to(0.0)

    def test_the_drive_stops_when_the_computer_falls_silent(self) -> None:
        """Without heartbeats it stops by itself, reports why, and moves only after its fault has been reset."""
        with self._ready() as bench:
            # A drive misses only a heartbeat that it has received before.
            bench.clock.sleep(2 * bench.opened.heartbeat.period_ms / 1000)
            start = bench.drive.position()
            bench.drive.start_move(start + bench.opened.distance, bench.speed / 100)
            bench.opened.clock.sleep(2 * bench.opened.heartbeat.timeout_ms / 1000)
            bench.wait_until_still()
            assert bench.drive.faults()
            assert _refuses(bench.drive.read)
            assert _refuses(bench.drive.enable)
            bench.drive.reset_fault()
            assert bench.drive.faults() == ()
            bench.drive.enable()
            bench.move_to(start)

    def test_closing_restores_the_current_limit(self) -> None:
        """A limit holds until `close`, then the drive has its own again; a drive without a limit refuses one."""
        with self._bench() as bench:
            own_ma = bench.drive.current_limit_ma()
            if own_ma is None:
                assert _refuses(lambda: bench.drive.configure(bench.opened.heartbeat, 1))
                return
            bench.drive.configure(bench.opened.heartbeat, own_ma // 2)
            limit_ma = bench.drive.current_limit_ma()
            bench.drive.close()
            assert bench.drive.current_limit_ma() == own_ma
            bench.drive.set_current_limit(own_ma // 2)
            halved_ma = bench.drive.current_limit_ma()
            bench.drive.set_current_limit(own_ma)
            assert bench.drive.current_limit_ma() == own_ma
            for found_ma in (limit_ma, halved_ma):
                assert found_ma is not None
                assert 0.9 * (own_ma // 2) < found_ma <= own_ma // 2 + 1

    def test_a_closed_drive_has_neither_power_nor_fault(self) -> None:
        """Closing ends both heartbeats without a fault."""
        with self._ready() as bench:
            bench.drive.close()
            bench.opened.clock.sleep(2 * bench.opened.heartbeat.timeout_ms / 1000)
            assert bench.drive.faults() == ()
            assert _refuses(bench.drive.read)


def _sent_requests(link: CanLink) -> list[bytes]:
    """Return the SDO requests that were sent since the frames of a link were last taken."""
    frames = link.network.take_frames()
    return [data for _, can_id, data, way in frames if way == "T" and 0x600 < can_id < 0x680]


def _refuses(act: Callable[[], object]) -> bool:
    """Tell whether something raises `DriveError`."""
    try:
        act()
    except DriveError:
        return True
    return False
