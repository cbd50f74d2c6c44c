"""Tries whether an axis stops by itself when labrig falls silent, which no setting that is read back proves."""

from labrig.devices.check_result import CheckResult, CheckStatus, passed, warned
from labrig.devices.operator import ConfirmMotion
from labrig.devices.rig import Rig

_SPEED = {"mm": 1.0, "rad": 0.2}
"""Fastest speed of the test [mm/s or rad/s]."""

_BRAKING_S = 0.5
"""Time for braking after the heartbeat's timeout, and then for standing still [s]."""

_USE_IT_FOR_NOTHING = (
    "use it for nothing: find out in its manual how it stops when the heartbeat of the computer ends"
)


def try_dead_man(rig: Rig, name: str) -> CheckResult:
    """Move an axis slowly, fall silent, and return whether it stopped; a person is asked before it moves.

    The rig beats no more afterwards.

    Raises
    ------
    SafetyStopError
        When a needle is or may be in tissue, or the axis may still move.
    DriveError, BusError, InterruptedRunError
    """
    rig.needle.refuse_in_tissue("no axis is moved", rig.description.option)
    axis, beat, check = rig.axis(name), rig.description.can.heartbeat, f"silence {name}"
    silent_s = beat.timeout_ms / 1000 + _BRAKING_S
    speed = axis.description.nearest_speed(min(_SPEED[axis.unit], axis.max_speed))
    what = f"move forwards by up to {2 * speed * silent_s:.2g} {axis.unit}, without a needle"
    if not rig.ask(ConfirmMotion(name, what)).confirmed:
        return warned(check, "not tried", "try it before a needle is mounted")
    axis.start_jog(2 * speed * silent_s, speed)
    rig.wait(2 * beat.period_ms / 1000)
    rig.fall_silent()
    places = [axis.drive.position()]
    for pause_s in (silent_s, _BRAKING_S):
        rig.clock.sleep(pause_s)
        places.append(axis.drive.position())
    rig.stop()
    axis.drive.reset_fault()
    way = f"{abs(places[1] - places[0]):.2g} {axis.unit} after the last heartbeat"
    if abs(places[2] - places[1]) > axis.description.position_window:
        return CheckResult(check, CheckStatus.FAIL, f"it moved on, {way}", _USE_IT_FOR_NOTHING)
    return passed(check, f"it stopped by itself, {way}")
