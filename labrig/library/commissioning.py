"""Commissioning a bare rig axis by axis: homing and short moves, all of it slowly.

Nothing here changes a rig file. Each motion is noted beside the rig's state file. A person has a hand on the emergency
stop and confirms each motion before it begins.
"""

import math

from labrig.devices.check_result import CheckResult, passed
from labrig.devices.drives.drive import HOMING_HERE
from labrig.devices.homing import HOME_ORDER, ZEROS
from labrig.devices.operator import ConfirmHere, ConfirmMotion, ConfirmNeedleOut, OperatorRequest
from labrig.devices.rig import Rig
from labrig.errors import InputError, SafetyStopError

SLOW = {"mm": 1.0, "rad": 0.2}
"""Default speed of a jog [mm/s or rad/s]."""

FASTEST = {"mm": 5.0, "rad": 1.0}
"""Highest speed of a jog [mm/s or rad/s]."""

USUAL_DISTANCE = {"mm": 10.0, "rad": math.pi / 2}
"""Default distance of a jog [mm or rad]."""

FARTHEST = {"mm": 20.0, "rad": math.pi}
"""Longest jog of an axis without a reference [mm or rad]."""


def make_sure_needle_is_out(rig: Rig) -> None:
    """Have the operator confirm that no needle is in tissue, if the rig does not know it.

    Raises
    ------
    SafetyStopError
        When the rig knows of a needle in tissue, or the operator does not confirm.
    """
    if rig.state.needle_in_tissue:
        raise SafetyStopError(
            f"no axis is moved by itself: {rig.state.doubt}", rig.state.find_way_out(rig.description.option)
        )
    if rig.state.needle_in_tissue is None:
        _confirm(rig, ConfirmNeedleOut(rig.state.doubt))
        rig.needle.mark_out()


def home_axes(rig: Rig, method: int | None, *, needle_mounted: bool) -> list[CheckResult]:
    """Home the open axes in their order, each once it is confirmed.

    Parameters
    ----------
    method : int or None
        Homing method of the drive; None uses that of the rig file.
    needle_mounted : bool
        Whether a needle is in the clamp.

    Raises
    ------
    SafetyStopError
        When a homing is not allowed or not confirmed.
    DriveError, BusError, InterruptedRunError
    """
    make_sure_needle_is_out(rig)
    open_axes = {axis.name: axis for axis in rig.axes}
    findings = []
    for name in (candidate for candidate in HOME_ORDER if candidate in open_axes):
        axis = open_axes[name]
        way = axis.description.homing.method if method is None else method
        rig.check_homing(name, way, needle_mounted=needle_mounted)
        _confirm(rig, _make_homing_request(rig, name, way, needle_mounted=needle_mounted))
        rig.home_axis(name, way, needle_mounted=needle_mounted)
        position = rig.read_states()[name].position
        findings.append(passed(f"{name} reference", f"method {way}, stands at {position:.4g} {axis.unit}"))
    return findings


def _make_homing_request(rig: Rig, name: str, method: int, *, needle_mounted: bool) -> OperatorRequest:
    axis = rig.axis(name)
    if method == HOMING_HERE:
        return ConfirmHere(name, axis.description.homing.position, axis.unit, ZEROS[name])
    way = "forwards" if axis.description.homing_direction(method) > 0 else "backwards"
    end = "its stop" if method < 0 else "its limit switch"
    needle = "a needle is mounted, not in tissue" if needle_mounted else "no needle is mounted"
    return ConfirmMotion(
        name,
        f"search {way} for {end} at {axis.description.homing.speed:g} {axis.unit}/s (method {method}; {needle})",
    )


def jog(rig: Rig, name: str, distance: float, speed: float | None = None) -> CheckResult:
    """Move one axis by a distance [mm or rad], slowly and once confirmed; return the distance by its encoder.

    Raises
    ------
    InputError
        When it is too far or too fast for a jog; nothing moves.
    SafetyStopError
        When a needle is in tissue, or the operator does not confirm.
    DriveError, BusError, InterruptedRunError
    """
    make_sure_needle_is_out(rig)
    axis = rig.axis(name)
    chosen = _jog_speed(axis.unit, speed)
    if not axis.referenced and abs(distance) > FARTHEST[axis.unit]:
        raise InputError(
            f"axis {name}: {distance:g} {axis.unit} is too far for an axis without a reference, "
            f"at most {FARTHEST[axis.unit]:.4g}",
            f"ask for less, or first: labrig devices home --axis {name} {rig.description.option}",
        )
    _confirm(rig, ConfirmMotion(name, f"move by {distance:g} {axis.unit} at {chosen:g} {axis.unit}/s"))
    before = axis.read().position
    axis.start_jog(distance, chosen)
    went = _wait_for(rig, name) - before
    return passed(f"{name} jog", f"{distance:g} {axis.unit} asked, {went:.4g} {axis.unit} by its encoder")


def _jog_speed(unit: str, speed: float | None) -> float:
    chosen = SLOW[unit] if speed is None else speed
    if not 0 < chosen <= FASTEST[unit]:
        raise InputError(
            f"a jog of {chosen:g} {unit}/s is not within 0 to {FASTEST[unit]:g} {unit}/s",
            "ask for a slower one",
        )
    return chosen


def _wait_for(rig: Rig, name: str) -> float:
    while True:
        rig.wait(rig.state_period_s)
        state = rig.read_states()[name]
        if state.target_reached:
            return state.position


def _confirm(rig: Rig, request: OperatorRequest) -> None:
    if not rig.ask(request).confirmed:
        raise SafetyStopError(
            f"the operator said no to: {request.text}", "start again when it can be confirmed"
        )
