"""Commissioning a bare rig axis by axis: homing, travel against a scale, play, and limits, all of it slowly.

Nothing here changes a rig file: each finding says what to write where. Each motion is noted beside the rig's state
file. A person has a hand on the emergency stop and confirms each motion before it begins.
"""

import math
from dataclasses import dataclass

from labrig.devices.axis_description import AxisDescription
from labrig.devices.homing import HOME_ORDER, HOMING_HERE, ZEROS
from labrig.devices.operator import (
    ConfirmFree,
    ConfirmHere,
    ConfirmMotion,
    ConfirmNeedleOut,
    OperatorRequest,
    ReadScale,
)
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

_READABLE = {"mm": 0.25, "rad": math.radians(2.0)}
"""Accuracy of reading a scale by eye [mm or rad]: half a line of graph paper at either end."""

_SAME_FRACTION = 0.02
_STILL_FRACTION = 0.2


@dataclass(frozen=True)
class Finding:
    """The result of a check of an axis.

    Parameters
    ----------
    axis, check : str
        The axis, and the check.
    status : str
        PASS, or FAIL if the rig file must be changed before anything else moves.
    value : str
        What was found.
    solution : str
        What to write into the rig file, or to do; empty if nothing.
    """

    axis: str
    check: str
    status: str
    value: str
    solution: str = ""


def judge_travel(name: str, axis: AxisDescription, commanded: float, measured: float) -> Finding:
    """Judge the travel of an axis as a person has read it [mm or rad].

    Returns
    -------
    Finding
        FAIL names a wrong sign or a wrong lead or gear ratio, and what to write instead.
    """
    value = f"{commanded:g} {axis.unit} asked, {measured:.4g} {axis.unit} read"
    if abs(measured) <= _STILL_FRACTION * abs(commanded):
        advice = (
            f"check whether the coupling slips; if it does not, correct axes.{name} gear_ratio and lead_mm"
        )
        return Finding(name, "travel", "FAIL", f"{value}: it hardly moved", advice)
    if measured * commanded < 0:
        turned = "false" if axis.reversed else "true"
        return Finding(
            name,
            "direction",
            "FAIL",
            f"{value}: the wrong way",
            f"write axes.{name}.reversed: {turned}, then check again",
        )
    if abs(measured - commanded) <= max(_READABLE[axis.unit], _SAME_FRACTION * abs(commanded)):
        return Finding(name, "travel", "PASS", value)
    return Finding(
        name, "travel", "FAIL", f"{value}: the wrong lead", _advise_lead(name, axis, measured / commanded)
    )


def _advise_lead(name: str, axis: AxisDescription, ratio: float) -> str:
    if axis.unit == "mm" and axis.lead_mm is not None:
        key, value, stated = "lead_mm", axis.lead_mm * ratio, axis.lead_mm
    else:
        stated = axis.gear_ratio or 1.0
        key, value = "gear_ratio", stated / ratio
    return f"write axes.{name}.{key}: {value:.4g} (it says {stated:g}) if its data sheet agrees, then check again"


def judge_backlash(name: str, axis: AxisDescription, commanded: float, measured: float) -> Finding:
    """Judge the play of an axis from the distance that it came back after a reversal [mm or rad]."""
    play = max(0.0, abs(commanded) - abs(measured))
    value = f"{play:.3g} {axis.unit} of play, the rig file says {axis.backlash:g}"
    if abs(play - axis.backlash) <= _READABLE[axis.unit] / 2:
        return Finding(name, "backlash", "PASS", value)
    return Finding(name, "backlash", "FAIL", value, f"write axes.{name}.backlash: {play:.3g}")


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


def home_axes(rig: Rig, method: int | None, *, needle_mounted: bool) -> list[Finding]:
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
        findings.append(
            Finding(name, "reference", "PASS", f"method {way}, stands at {position:.4g} {axis.unit}")
        )
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


def jog(rig: Rig, name: str, distance: float, speed: float | None = None) -> Finding:
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
    went = _jog(rig, name, distance, speed)
    unit = rig.axis(name).unit
    return Finding(name, "jog", "PASS", f"{distance:g} {unit} asked, {went:.4g} {unit} by its encoder")


def check_travel(rig: Rig, name: str, distance: float, speed: float | None = None) -> list[Finding]:
    """Move one axis by a distance and back, and compare it with a scale that a person reads three times.

    The way there tells direction, and lead or gear; the way back tells the play. Raises as `jog`.
    """
    make_sure_needle_is_out(rig)
    axis = rig.axis(name).description
    begin = _read_scale(rig, name, "Lay a scale beside the axis, positive the way the axis counts.")
    _jog(rig, name, distance, speed)
    there = _read_scale(rig, name, "The axis has moved.")
    travel = judge_travel(name, axis, distance, there - begin)
    if travel.status == "FAIL":
        return [travel]
    _jog(rig, name, -distance, speed)
    end = _read_scale(rig, name, "The axis has gone back.")
    return [travel, judge_backlash(name, axis, -distance, end - there)]


def check_limits(rig: Rig, name: str, speed: float | None = None) -> list[Finding]:
    """Move a referenced axis to each of its limits, have a person confirm that it is free there, and move back to zero.

    Raises as `jog`.
    """
    make_sure_needle_is_out(rig)
    axis = rig.axis(name)
    findings = []
    for limit in axis.limits:
        _jog_to(rig, name, limit, speed)
        _confirm(rig, ConfirmFree(name, limit, axis.unit))
        findings.append(
            Finding(name, "limit", "PASS", f"{limit:g} {axis.unit} reached, free of stops as confirmed")
        )
    _jog_to(rig, name, min(max(0.0, axis.limits[0]), axis.limits[1]), speed)
    return findings


def _jog(rig: Rig, name: str, distance: float, speed: float | None) -> float:
    axis = rig.axis(name)
    chosen = _jog_speed(axis.unit, speed)
    if not axis.referenced and abs(distance) > FARTHEST[axis.unit]:
        raise InputError(
            f"axis {name}: {distance:g} {axis.unit} is too far for an axis without a reference, "
            f"at most {FARTHEST[axis.unit]:.4g}",
            f"ask for less, or first: labrig devices home --axis {name} {rig.description.option}",
        )
    what = f"move by {distance:g} {axis.unit} at {chosen:g} {axis.unit}/s"
    _confirm(rig, ConfirmMotion(name, what))
    before = axis.read().position
    axis.start_jog(distance, chosen)
    return _wait_for(rig, name) - before


def _jog_to(rig: Rig, name: str, position: float, speed: float | None) -> None:
    axis = rig.axis(name)
    chosen = axis.description.nearest_speed(min(_jog_speed(axis.unit, speed), axis.max_speed))
    what = f"move to {position:g} {axis.unit} at {chosen:.3g} {axis.unit}/s"
    _confirm(rig, ConfirmMotion(name, what))
    axis.start_move(position, chosen)
    _wait_for(rig, name)


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


def _read_scale(rig: Rig, name: str, instruction: str) -> float:
    """Return what a person reads [mm or rad]; angles are read in degrees."""
    turns = rig.axis(name).unit == "rad"
    answer = rig.ask(ReadScale(name, "deg" if turns else "mm", instruction))
    if not answer.confirmed or answer.reading is None:
        raise SafetyStopError("no reading was given", "start again when the scale can be read")
    return math.radians(answer.reading) if turns else answer.reading


def _confirm(rig: Rig, request: OperatorRequest) -> None:
    if not rig.ask(request).confirmed:
        raise SafetyStopError(
            f"the operator said no to: {request.text}", "start again when it can be confirmed"
        )
