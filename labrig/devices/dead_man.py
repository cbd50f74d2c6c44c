"""Tries whether each axis stops by itself when labrig falls silent, which no setting that is read back proves."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack, suppress
from dataclasses import dataclass

from labrig.clock import Clock
from labrig.devices.axis_description import AxisDescription
from labrig.devices.can_description import HeartbeatDescription
from labrig.devices.check_result import CheckResult, CheckStatus, failed, passed, warned
from labrig.devices.drives.drive import STILL_POLL_S, Drive
from labrig.devices.exclusive import acquire_rig
from labrig.devices.hardware import make_hardware
from labrig.devices.heartbeat import HeartbeatClock
from labrig.devices.needle_state import NeedleState
from labrig.devices.rig_file import RigDescription, require_complete
from labrig.errors import LabrigError, MachineError

_SPEED = {"mm": 1.0, "rad": 0.2}
"""Fastest speed of the test [mm/s or rad/s]."""

_BRAKING_S = 0.5
"""Time for braking after the heartbeat's timeout, and then for standing still [s]."""

_USE_IT_FOR_NOTHING = (
    "use it for nothing: find out in its manual how it stops when the heartbeat of the computer ends"
)


def try_dead_man(rig: RigDescription, confirms: Callable[[str], bool]) -> Iterator[CheckResult]:
    """Move each axis slowly, fall silent, and yield whether it stopped; whoever calls this asks a person first.

    Parameters
    ----------
    rig : RigDescription
        The rig file; complete.
    confirms : callable
        Given what is about to move, tells whether it may.

    Raises
    ------
    InputError, LockedError, SafetyStopError, BusError
        Before anything moves.
    """
    require_complete(rig, tuple(rig.axes.model_dump()))
    NeedleState(rig.state_path).refuse_in_tissue("no axis is moved", rig.option)
    with ExitStack() as stack:
        stack.enter_context(acquire_rig(rig, "labrig devices check --move"))
        hardware = make_hardware(rig, seed=0)
        stack.callback(hardware.close)
        link = hardware.open_link()
        stack.callback(link.close)
        for name, axis in rig.axes.items():
            trial = _Trial(axis, HeartbeatClock(hardware.clock, link, rig.can.heartbeat), rig.can.heartbeat)
            check, way = f"silence {name}", f"{trial.distance:.2g} {axis.unit}"
            if not confirms(
                f"Axis {name} moves forwards by up to {way}, without a needle, a hand on the emergency stop"
            ):
                yield warned(check, "not tried", "try it before a needle is mounted")
                continue
            try:
                goes_on, way_after = trial.make(axis.open(link, name, trial.beating), hardware.clock)
            except LabrigError as error:
                yield failed(check, error)
                continue
            way = f"{way_after:.2g} {axis.unit} after the last heartbeat"
            yield (
                CheckResult(check, CheckStatus.FAIL, f"it moved on, {way}", _USE_IT_FOR_NOTHING)
                if goes_on
                else passed(check, f"it stopped by itself, {way}")
            )


@dataclass(frozen=True)
class _Trial:
    """How one axis is tried."""

    axis: AxisDescription
    beating: HeartbeatClock
    heartbeat: HeartbeatDescription

    @property
    def speed(self) -> float:
        return self.axis.nearest_speed(min(_SPEED[self.axis.unit], self.axis.max_speed))

    @property
    def distance(self) -> float:
        return 2 * self.speed * (self.heartbeat.timeout_ms / 1000 + _BRAKING_S)

    def make(self, drive: Drive, clock: Clock) -> tuple[bool, float]:
        """Return whether the axis moves on without a heartbeat, and how far it went."""
        drive.identify()
        drive.configure(self.heartbeat, self.axis.max_current_ma)
        try:
            drive.enable()
            drive.start_move(drive.position() + self.distance, self.speed)
            self.beating.sleep(2 * self.heartbeat.period_ms / 1000)
            start = drive.position()
            clock.sleep(self.heartbeat.timeout_ms / 1000 + _BRAKING_S)
            stood = drive.position()
            clock.sleep(_BRAKING_S)
            return abs(drive.position() - stood) > self.axis.position_window, abs(stood - start)
        finally:
            drive.post_stop(quick=True)
            with suppress(MachineError):
                for _ in drive.wait_until_still(1.0):
                    clock.sleep(STILL_POLL_S)
                drive.reset_fault()
            drive.close()
