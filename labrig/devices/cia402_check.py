"""The checks of any CiA 402 drive in `labrig devices check`: its reference and its limits."""

from typing import Any

from labrig.devices import canopen_objects as co
from labrig.devices.axis_description import AxisDescription
from labrig.devices.check_result import CheckResult, CheckStatus
from labrig.devices.cia402_drive import Cia402Drive
from labrig.devices.sdo_client import NO_OBJECT
from labrig.errors import DriveRefusedError


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
