"""The driver over every bus: inside the process in simulated time, and over python-can in real time."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial

import pytest

from labrig.clock import Clock
from labrig.devices import canopen_objects as co
from labrig.devices.bus import open_can
from labrig.devices.can_description import CanDescription, HeartbeatDescription
from labrig.devices.cia402_states import (
    HALT,
    HOMING_ATTAINED,
    SETPOINT_ACKNOWLEDGED,
    TARGET_REACHED,
    DriveState,
    TargetState,
    decode_state,
)
from labrig.devices.clocks import SystemClock
from labrig.devices.drive import Homing
from labrig.devices.epos2.driver import Epos2
from labrig.devices.epos2.simulated_drive import SimulatedDrive
from labrig.devices.heartbeat import HeartbeatClock
from labrig.devices.homing import HOMING_HERE
from labrig.errors import (
    DriveError,
    DriveFaultError,
    DriveRefusedError,
    DriveRestartedError,
    DriveSilentError,
)
from tests.devices.rigs import epos2_axis, one_drive
from tests.devices.served import INTERFACES, served_drives

pytestmark = pytest.mark.slow

PATIENCE_S = 60.0
ANSWER_TIMEOUT_MS = 5000
SETTINGS = {
    co.POSITION_WINDOW: 20,
    co.POSITION_WINDOW_TIME: 20,
    co.PROFILE_ACCELERATION: 20_000,
    co.PROFILE_DECELERATION: 20_000,
    co.QUICK_STOP_DECELERATION: 100_000,
}
FAST_RPM, FAR = 600, 1_000_000


@dataclass
class OnABus:
    """A driver, the drive that it talks to, and how to do something to that drive behind the driver's back."""

    driver: Epos2
    drive: SimulatedDrive
    clock: Clock
    do: Callable[[Callable[[], object]], object]

    def wait_until(self, condition: Callable[[], object]) -> None:
        """Let time pass until something is so."""
        given_up_s = self.clock.now_s() + PATIENCE_S
        while not condition():
            assert self.clock.now_s() < given_up_s
            self.clock.sleep(0.01)

    def arrive(self) -> None:
        """Wait for the end of a move."""
        self.wait_until(lambda: self.driver.statusword() & TARGET_REACHED)

    def raises_in_time(self, error: type[DriveError], words: str) -> None:
        """Wait for an error that names what the drive reports by itself."""

        def has_reported() -> bool:
            try:
                self.driver.check()
            except error as reported:
                return words in reported.message
            return False

        self.wait_until(has_reported)


@contextmanager
def _serve_drives(interface: str) -> Iterator[OnABus]:
    with ExitStack() as stack:
        served = stack.enter_context(served_drives(interface, (1,)))
        reached_by = dict(served.reached_by)
        can = {key: reached_by.pop(key) for key in ("interface", "channel")}
        reached_by.pop("bitrate", None)
        clock = SystemClock()
        description = CanDescription.model_validate(
            {**can, "options": reached_by, "answer_timeout_ms": ANSWER_TIMEOUT_MS}
        )
        link = open_can(description, clock)
        stack.callback(link.close)
        yield OnABus(Epos2(link, epos2_axis(), "insertion", clock), served.drives[1], clock, served.do)


@contextmanager
def _in_process() -> Iterator[OnABus]:
    with one_drive() as bench:
        yield OnABus(bench.driver, bench.drive, bench.clock, lambda action: action())


@pytest.fixture(name="bare", params=["in-process", *INTERFACES])
def _bare(request: pytest.FixtureRequest) -> Iterator[OnABus]:
    with _in_process() if request.param == "in-process" else _serve_drives(request.param) as on_a_bus:
        yield on_a_bus


@pytest.fixture(name="ready")
def _ready(bare: OnABus) -> OnABus:
    bare.driver.hold_off()
    bare.driver.expect_fingerprint((1, 2))
    bare.driver.write_settings(SETTINGS)
    bare.driver.enable()
    return bare


def test_connecting_verifies_writes_and_reads_back(bare: OnABus) -> None:
    """Identity, encoder and COB-IDs are verified; only different settings are written, the fingerprint last."""
    identity = bare.driver.read_identity()
    assert (identity.model, identity.serial_number) == ("EPOS2 24/5", 1001)
    bare.driver.section = epos2_axis(encoder_pulses_per_turn=512)
    with pytest.raises(DriveError, match="500 encoder pulses a turn, the rig file says 512"):
        bare.driver.require_encoder()
    bare.driver.hold_off()
    bare.driver.expect_fingerprint((1, 2))
    assert set(bare.driver.write_settings(SETTINGS)) == {entry.place for entry in SETTINGS}
    assert bare.driver.write_settings(SETTINGS) == ()
    assert {entry: bare.driver.upload(entry) for entry in SETTINGS} == SETTINGS
    bare.driver.section = epos2_axis(configuration_fingerprint=(1, 2))
    bare.driver.require_fingerprint()
    bare.driver.section = epos2_axis(configuration_fingerprint=(1, 3))
    with pytest.raises(DriveError, match="parameters have been changed"):
        bare.driver.require_fingerprint()


def test_enabling_moves_nothing(bare: OnABus) -> None:
    """The actual position replaces a stale target, with Halt, before power comes on."""
    bare.driver.hold_off()
    bare.driver.download(co.TARGET_POSITION, FAR)
    bare.driver.enable()
    assert bare.driver.upload(co.TARGET_POSITION) == 0
    assert bare.driver.upload(co.CONTROLWORD) & HALT
    assert bare.drive.shaft_counts == 0


def test_moves_arrive_and_can_be_changed_on_their_way(ready: OnABus) -> None:
    """Both edges of the handshake are checked; a second set-point replaces the first, also backwards."""
    ready.driver.start_profile(FAR, FAST_RPM)
    assert not ready.driver.statusword() & SETPOINT_ACKNOWLEDGED
    ready.driver.start_profile(-1000, 2 * FAST_RPM)
    ready.arrive()
    assert ready.driver.counter() == ready.drive.shaft_counts == -1000


def _is_beyond(bus: OnABus, counter: int) -> bool:
    return bus.driver.counter() > counter


def test_halt_holds_and_quick_stop_leaves_operation(ready: OnABus) -> None:
    """After each of them the position no longer changes."""
    for stop, state in (
        (ready.driver.stop, DriveState.OPERATION_ENABLED),
        (partial(ready.driver.stop, quick=True), DriveState.QUICK_STOP_ACTIVE),
    ):
        passed = partial(_is_beyond, ready, ready.driver.counter())
        ready.driver.start_profile(FAR, FAST_RPM)
        ready.wait_until(passed)
        stop()
        ready.driver.settle(PATIENCE_S)
        assert decode_state(ready.driver.statusword()) is state
        assert 0 < ready.drive.shaft_counts < FAR


def test_homing_here_and_homing_that_is_halted(ready: OnABus) -> None:
    """Method 35 sets the position to zero; Halt ends a search without a stop, which attains nothing."""
    ready.driver.start_profile(2000, FAST_RPM)
    ready.arrive()
    ready.driver.start_homing(Homing(HOMING_HERE))
    ready.wait_until(ready.driver.has_homed)
    ready.driver.finish_homing(Homing(HOMING_HERE))
    assert (ready.driver.counter(), ready.drive.shaft_counts) == (0, 2000)
    assert ready.driver.is_referenced()
    ready.driver.start_homing(Homing(-3, timeout_s=PATIENCE_S))
    assert not ready.driver.has_homed()
    ready.driver.stop()
    ready.driver.settle(PATIENCE_S)
    assert not ready.driver.statusword() & HOMING_ATTAINED
    homing = ready.drive.journal.last("homing")
    assert homing is not None
    assert homing.text == "stopped"


def test_a_homing_that_takes_too_long_is_given_up(ready: OnABus) -> None:
    """The attained bit of an earlier homing does not count."""
    ready.driver.start_homing(Homing(HOMING_HERE))
    ready.wait_until(ready.driver.has_homed)
    ready.driver.finish_homing(Homing(HOMING_HERE))
    ready.driver.start_homing(Homing(-3, timeout_s=0.05))
    with pytest.raises(DriveError, match="did not find home in time"):
        ready.wait_until(ready.driver.has_homed)


def test_a_refusal_carries_its_code(bare: OnABus) -> None:
    """An SDO abort becomes a typed error."""
    with pytest.raises(DriveRefusedError, match="the value is too low") as refusal:
        bare.driver.download(co.PROFILE_VELOCITY, 0)
    assert refusal.value.code == 0x06090032


def test_an_emergency_names_code_register_text_and_remedy(ready: OnABus) -> None:
    """The axis brakes by itself, the driver reports why without a request, and nothing enables it again."""
    ready.driver.start_profile(FAR, FAST_RPM)
    ready.do(lambda: ready.drive.fail(0x4210))
    ready.raises_in_time(DriveFaultError, "error 0x4210, over-temperature")
    with pytest.raises(DriveFaultError) as fault:
        ready.driver.go_to(TargetState.ENABLED)
    assert (fault.value.code, fault.value.register) == (0x4210, 0x09)
    assert fault.value.text
    assert fault.value.remedy
    ready.wait_until(lambda: decode_state(ready.driver.statusword()) is DriveState.FAULT)
    ready.driver.settle(PATIENCE_S)


def test_passing_a_limit_is_a_fault(ready: OnABus) -> None:
    """The drive reports 0xFF09."""
    ready.driver.download(co.UPPER_LIMIT, 2000)
    ready.driver.start_profile(FAR, FAST_RPM)
    ready.raises_in_time(DriveFaultError, "0xFF09")
    ready.driver.settle(PATIENCE_S)
    assert ready.drive.shaft_counts < FAR


def test_a_restart_is_noticed(ready: OnABus) -> None:
    """The boot-up frame shows that position and reference are lost."""
    ready.do(ready.drive.restart)
    ready.raises_in_time(DriveRestartedError, "has restarted")


def test_each_side_notices_a_lost_heartbeat(ready: OnABus) -> None:
    """The drive stops when the computer falls silent, and the driver raises when the drive does."""
    ready.driver.download(co.CONSUMER_HEARTBEAT, 127 << 16 | 100)
    heartbeat = HeartbeatDescription(period_ms=10, timeout_ms=100)
    HeartbeatClock(ready.clock, ready.driver._link, heartbeat).beat()
    ready.raises_in_time(DriveFaultError, "error 0x8130")


def test_a_drive_without_heartbeat_is_silent(ready: OnABus) -> None:
    """The error names the drive and how long it has been silent."""
    ready.driver.watch(20, 0.2)
    ready.do(ready.drive.stop_heartbeat)
    ready.raises_in_time(DriveSilentError, "has sent no heartbeat")
