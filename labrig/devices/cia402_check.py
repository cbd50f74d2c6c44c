"""The checks of any CiA 402 drive in `labrig devices check`: its reference, its limits, its current and inputs."""

from collections.abc import Iterator
from typing import Any

from labrig.devices import canopen_objects as co
from labrig.devices.axis_description import AxisDescription
from labrig.devices.check_result import CheckResult, CheckStatus, failed
from labrig.devices.cia402_drive import Cia402Drive
from labrig.devices.sdo_client import NO_OBJECT
from labrig.errors import DriveError, DriveRefusedError


def check_limits(name: str, axis: AxisDescription, drive: Cia402Drive[Any]) -> CheckResult:
    """Compare the limits in the drive with those of the rig file; without a reference it has none."""
    low, high = axis.limits
    value = f"[{low:g}, {high:g}] {axis.unit}, {axis.max_speed:g} {axis.unit}/s"
    if not drive.has(co.LOWER_LIMIT):
        return CheckResult(f"limits {name}", CheckStatus.PASS, f"{value}; the drive has no limits")
    if axis.unknown or not drive.is_referenced():
        return CheckResult(
            f"limits {name}", CheckStatus.PASS, f"{value}; the drive has none until referenced"
        )
    scale = axis.scale()
    margin = scale.to_distance_counts(axis.position_window)
    lower, upper = sorted(map(scale.to_counts, axis.limits))
    found = (drive.upload(co.LOWER_LIMIT), drive.upload(co.UPPER_LIMIT))
    if found == (lower - margin, upper + margin):
        return CheckResult(f"limits {name}", CheckStatus.PASS, f"{value}, also in the drive")
    return CheckResult(
        f"limits {name}",
        CheckStatus.WARN,
        f"{value}; the drive holds {found[0]} to {found[1]} {axis.count_unit}",
        f"reference the axis again: labrig devices home --axis {name} --rig FILE",
    )


def check_dead_man(name: str, drive: Cia402Drive[Any]) -> CheckResult:
    """Read what the drive does when it has to stop by itself; a run sets it, where the drive has it."""
    found: dict[str, int] = {}
    missing, check = [], f"dead-man {name}"
    for entry in drive.stop_options():
        try:
            found[entry.place] = drive.upload(entry)
        except DriveRefusedError as error:
            if error.code != NO_OBJECT:
                raise
            missing.append(f"{entry.name} ({entry.place})")
    value = ", ".join(f"{place} = {option}" for place, option in found.items())
    if not missing:
        return CheckResult(check, CheckStatus.PASS, f"{value}; a run sets and reads back what it needs")
    return CheckResult(
        check,
        CheckStatus.WARN,
        f"not guarded, the drive does not have: {', '.join(missing)}",
        "find out in its manual how it stops when the heartbeat of the computer ends",
    )


def check_reference(name: str, drive: Cia402Drive[Any]) -> CheckResult:
    """Report whether the drive has its reference, and its state."""
    state = drive.decode(drive.statusword()).name
    if drive.is_referenced():
        return CheckResult(f"reference {name}", CheckStatus.PASS, f"referenced, {state}")
    return CheckResult(
        f"reference {name}",
        CheckStatus.WARN,
        f"not referenced, {state}",
        f"a run asks for zero before it moves; or: labrig devices home --axis {name} --rig FILE",
    )


def check_current(name: str, axis: AxisDescription, drive: Cia402Drive[Any]) -> CheckResult:
    """Compare the current limit of the rig file with that of the drive; a run writes the lower one."""
    check, own_ma, now_ma = f"current {name}", drive.current_limit_ma(), drive.current_ma()
    now = "not reported" if now_ma is None else f"{now_ma:.0f} mA"
    try:
        drive.require_limits()
    except DriveError as error:
        return failed(check, error)
    if own_ma is None:
        return CheckResult(
            check,
            CheckStatus.WARN,
            f"{now}; neither limited nor guarded against a stall: labrig knows no current limit of this drive",
            f"name its object in the rig file, or set the limit in {drive.tool}",
        )
    if axis.max_current_ma is None:
        return CheckResult(
            check,
            CheckStatus.WARN,
            f"{now}; limit {own_ma} mA, the drive's own; not guarded against a stall",
            f"write axes.{name}.max_current_ma: the least with which the axis still moves freely, and some more",
        )
    return CheckResult(
        check, CheckStatus.PASS, f"{now}; limit {axis.max_current_ma} mA, the drive's own {own_ma} mA"
    )


def check_inputs(name: str, axis: AxisDescription, drive: Cia402Drive[Any]) -> Iterator[CheckResult]:
    """Read each input that the rig file names, and compare it with its limits."""
    for channel_name, value in drive.read_inputs().items():
        channel = axis.inputs[channel_name]
        what = f"{channel.format_value(value)} at {channel.source} of the drive of axis {name}"
        limits = channel.format_limits() or "only recorded"
        excess = channel.find_excess(channel_name, name, value)
        if excess is None:
            yield CheckResult(f"input {channel_name}", CheckStatus.PASS, f"{what}, {limits}")
        else:
            yield CheckResult(
                f"input {channel_name}", CheckStatus.WARN, f"{what}, {limits}: no run begins", excess.hint
            )
