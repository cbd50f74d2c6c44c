"""`labrig devices check` of an axis with a CiA 402 drive: it is compared with the rig file; nothing is written."""

from collections.abc import Iterator

from labrig.clock import Clock
from labrig.devices.axis_description import AxisDescription
from labrig.devices.bus import CanLink
from labrig.devices.check_result import CheckResult, failed, passed, warned
from labrig.devices.drives import objects as co
from labrig.devices.drives.cia402 import Cia402Drive
from labrig.devices.drives.states import describe_statusword
from labrig.errors import LabrigError

_GUARDS = {
    co.ABORT_CONNECTION: "what the drive does when the computer's heartbeat stops (0x6007)",
    co.FAULT_REACTION: "how it stops on a fault (0x605E)",
    co.SHUTDOWN_OPTION: "how it stops when it is switched off (0x605B)",
    co.DISABLE_OPTION: "how it stops when operation is disabled (0x605C)",
    co.MAX_FOLLOWING_ERROR: "an axis that lags behind (0x6065)",
    co.LOWER_LIMIT: "the lower limit in the drive (0x607D:01)",
    co.UPPER_LIMIT: "the upper limit in the drive (0x607D:02)",
}
"""Objects that keep an axis safe -> what is not guarded in a drive that lacks them."""


def check_axis(link: CanLink, axis: AxisDescription, name: str, clock: Clock) -> Iterator[CheckResult]:
    """Compare an axis of the rig file with its drive."""
    drive = Cia402Drive(link, axis, name, clock)
    try:
        yield _check_identity(drive, name)
        if fault := drive.fault():
            raise fault
        yield from (failed(f"settings {name}", error) for error in drive.find_differences())
        if not axis.unknown:
            excesses = [failed(f"limits {name}", error) for error in drive.find_excesses()]
            yield from excesses or [_check_current(drive, name)]
        yield _check_reference(drive, name)
        yield from _check_inputs(drive, name)
        yield _check_guards(drive, name)
    except LabrigError as error:
        yield failed(f"drive {name}", error)


def _check_identity(drive: Cia402Drive, name: str) -> CheckResult:
    identity = drive.read_identity()
    versions = (f"{key.replace('_', ' ')} 0x{value:08X}" for key, value in identity.versions.items())
    value = ", ".join((f"node {drive.node_id}: {identity.model}", *versions))
    value += "" if identity.serial_number is None else f", serial {identity.serial_number}"
    if drive.model.fingerprint:
        value += f", configuration_fingerprint {list(drive.read_fingerprint())} (date, time of settings)"
    if not identity.doubt:
        return passed(f"drive {name}", value)
    solution = "a run reads every setting back; try homing, jog and the emergency stop without a needle first"
    return warned(f"drive {name}", f"{value}; {identity.doubt}", solution)


def _check_reference(drive: Cia402Drive, name: str) -> CheckResult:
    state = describe_statusword(drive.upload(co.STATUSWORD))
    if drive.is_referenced():
        return passed(f"reference {name}", f"zero is known, {state}")
    solution = f"a run asks for zero before it moves; or: labrig devices home --axis {name} --rig FILE"
    return warned(f"reference {name}", f"zero is not known, {state}", solution)


def _check_current(drive: Cia402Drive, name: str) -> CheckResult:
    """Tell the current, its limits, and whether a stall is guarded against; a run writes the lower limit."""
    check, asked_ma = f"current {name}", drive.section.max_current_ma
    own_ma, now_ma = drive.reports.current_limit_ma(), drive.reports.current_ma()
    now = "not reported" if now_ma is None else f"{now_ma:.0f} mA"
    if own_ma is None:
        value = f"{now}; neither limited nor guarded against a stall: no current limit of this drive is known"
        return warned(check, value, "name its object in the rig file, or set the limit in the drive")
    if asked_ma is None:
        value = f"{now}; limit {own_ma} mA, the drive's own setting; not guarded against a stall"
        least = "the least with which the axis still moves freely, and some more"
        return warned(check, value, f"write axes.{name}.max_current_ma: {least}")
    return passed(check, f"{now}; limit {asked_ma} mA, the drive's own setting {own_ma} mA")


def _check_inputs(drive: Cia402Drive, name: str) -> Iterator[CheckResult]:
    """Read each input that the rig file names, and compare it with its limits."""
    for channel_name, value in drive.reports.read_inputs().items():
        check, channel = f"input {channel_name}", drive.section.inputs[channel_name]
        limits = channel.format_limits() or "only recorded"
        what = f"{channel.format_value(value)} at {channel.source} of the drive of axis {name}, {limits}"
        excess = channel.find_excess(channel_name, name, value)
        yield passed(check, what) if excess is None else warned(check, f"{what}: no run begins", excess.hint)


def _check_guards(drive: Cia402Drive, name: str) -> CheckResult:
    """Read how the drive stops by itself, and name what it does not guard."""
    found = {place: drive.find(place) for place in _GUARDS}
    missing = [guard for place, guard in _GUARDS.items() if found[place] is None]
    if missing:
        return warned(
            f"guards {name}",
            f"not reported or not guarded by the drive: {'; '.join(missing)}",
            "name the manufacturer's objects in the rig file if the drive has them; watch the axis for the others",
        )
    options = (f"{place} = {found[place]}" for place in drive.model.stop_options if place in found)
    return passed(f"guards {name}", f"how it stops by itself: {', '.join(options)}; a run sets what it needs")
