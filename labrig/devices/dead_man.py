"""Tries whether each axis stops by itself when labrig falls silent, which no setting that is read back proves."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack, suppress

from labrig.clock import Clock
from labrig.devices.axis_description import AxisDescription
from labrig.devices.bus import CanLink
from labrig.devices.can_description import HeartbeatDescription
from labrig.devices.check_result import CheckResult, CheckStatus, failed
from labrig.devices.drives.drive import STILL_POLL_S
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
            heartbeat = rig.can.heartbeat
            speed = axis.nearest_speed(min(_SPEED[axis.unit], axis.max_speed))
            distance = 2 * speed * (heartbeat.timeout_ms / 1000 + _BRAKING_S)
            if not confirms(
                f"Axis {name} moves forwards by up to {distance:.2g} {axis.unit}, without a needle, a hand on the "
                "emergency stop"
            ):
                yield CheckResult(
                    f"silence {name}", CheckStatus.WARN, "not tried", "try it before a needle is mounted"
                )
                continue
            try:
                yield _try_axis(
                    name, axis, link, hardware.clock, heartbeat=heartbeat, speed=speed, distance=distance
                )
            except LabrigError as error:
                yield failed(f"silence {name}", error)


def _try_axis(
    name: str,
    axis: AxisDescription,
    link: CanLink,
    clock: Clock,
    *,
    heartbeat: HeartbeatDescription,
    speed: float,
    distance: float,
) -> CheckResult:
    beating = HeartbeatClock(clock, link, heartbeat)
    drive = axis.open(link, name, beating)
    drive.identify()
    drive.configure(heartbeat, axis.max_current_ma)
    try:
        drive.enable()
        drive.start_move(drive.position() + distance, speed)
        beating.sleep(2 * heartbeat.period_ms / 1000)
        start = drive.position()
        clock.sleep(heartbeat.timeout_ms / 1000 + _BRAKING_S)
        stood = drive.position()
        clock.sleep(_BRAKING_S)
        goes_on = abs(drive.position() - stood) > axis.position_window
    finally:
        drive.post_stop(quick=True)
        with suppress(MachineError):
            for _ in drive.wait_until_still(1.0):
                clock.sleep(STILL_POLL_S)
            drive.reset_fault()
        drive.close()
    way = f"{abs(stood - start):.2g} {axis.unit} after the last heartbeat"
    if goes_on:
        return CheckResult(
            f"silence {name}",
            CheckStatus.FAIL,
            f"it moved on, {way}",
            "use it for nothing: find out in its manual how it stops when the heartbeat of the computer ends",
        )
    return CheckResult(f"silence {name}", CheckStatus.PASS, f"it stopped by itself, {way}")
