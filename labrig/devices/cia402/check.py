"""`labrig devices check` of an axis with a CiA 402 drive; nothing is written."""

from collections.abc import Callable, Iterator

from labrig.clock import Clock
from labrig.devices.bus import CanLink
from labrig.devices.can_description import HeartbeatDescription
from labrig.devices.check_result import CheckResult, CheckStatus, failed
from labrig.devices.cia402 import objects as od
from labrig.devices.cia402.driver import ProfileDrive
from labrig.devices.cia402.settings import Cia402Axis
from labrig.devices.cia402_check import check_current, check_inputs, check_limits, check_reference
from labrig.devices.drive import Identity
from labrig.errors import DriveError, LabrigError


def check_axis(
    link: CanLink, axis: Cia402Axis, name: str, clock: Clock, heartbeat: HeartbeatDescription
) -> Iterator[CheckResult]:
    """Compare an axis of the rig file with its drive."""
    drive = ProfileDrive(link, axis, name, clock)
    try:
        identity = drive.read_identity()
        yield _identity_result(name, axis, drive, identity)
        drive.raise_if_faulted()
        yield _comparison(
            f"units {name}", drive.require_units, f"{axis.speed_unit}, {axis.acceleration_unit}"
        )
        yield _comparison(
            f"encoder {name}", drive.require_counts, f"{axis.counts_per_turn or 0:g} counts a turn"
        )
        if not axis.unknown:
            yield _configuration_result(name, drive, heartbeat)
        yield check_reference(name, drive)
        yield check_limits(name, axis, drive)
        yield check_current(name, axis, drive)
        yield from check_inputs(name, axis, drive)
        yield _guards_result(name, axis, drive)
    except LabrigError as error:
        yield failed(f"drive {name}", error)


def _identity_result(name: str, axis: Cia402Axis, drive: ProfileDrive, identity: Identity) -> CheckResult:
    found, expected = identity.versions.get("revision_number"), drive.eds.revision
    value = f"node {axis.node_id}: {identity.model}, product 0x{identity.versions['product_code']:08X}"
    value += "" if found is None else f", revision 0x{found:08X}"
    value += "" if identity.serial_number is None else f", serial {identity.serial_number}"
    if None in {found, expected} or found == expected:
        return CheckResult(f"drive {name}", CheckStatus.PASS, value)
    return CheckResult(
        f"drive {name}",
        CheckStatus.WARN,
        f"{value}; its EDS file is for revision 0x{expected:08X}",
        "use the EDS file of this firmware: ranges and defaults may differ",
    )


def _comparison(check: str, require: Callable[[], None], value: str) -> CheckResult:
    try:
        require()
    except DriveError as error:
        return failed(check, error)
    return CheckResult(check, CheckStatus.PASS, value)


def _configuration_result(name: str, drive: ProfileDrive, heartbeat: HeartbeatDescription) -> CheckResult:
    """Compare every setting with the value that a run will write."""
    settings = drive.settings_of(heartbeat)
    others = [entry.place for entry, value in settings.items() if drive.upload(entry) != value]
    value = f"{len(settings)} settings as the rig file has them"
    if others:
        value = f"a run sets {len(others)} of {len(settings)} settings: {', '.join(others)}"
    return CheckResult(f"configuration {name}", CheckStatus.PASS, value)


def _guards_result(name: str, axis: Cia402Axis, drive: ProfileDrive) -> CheckResult:
    """Name what the drive does not guard because it lacks the object or the rig file does not name it."""
    missing = [guard for entry, guard in od.GUARDS.items() if not drive.has(entry)]
    optional = {
        "the motor current (objects.current_ma)": drive.current_ma() is None,
        "a limit of the current (objects.current_limit_ma)": drive.find_current_limit() is None,
        "a stall (0x60F4)": not drive.has(od.FOLLOWING_ERROR),
        "limit switches (0x60FD)": not drive.inputs(),
        "counts a turn (objects.counts_per_turn)": axis.objects.counts_per_turn is None,
        "the unit of velocities (0x60A9)": not drive.has(od.VELOCITY_UNIT),
        "whether it kept its reference (referenced_bit)": axis.referenced_bit is None,
    }
    missing += [guard for guard, is_missing in optional.items() if is_missing]
    if not missing:
        return CheckResult(f"guards {name}", CheckStatus.PASS, "complete, as far as labrig knows")
    return CheckResult(
        f"guards {name}",
        CheckStatus.WARN,
        f"not reported or not guarded by the drive: {'; '.join(missing)}",
        "name the manufacturer's objects in the rig file if the drive has them; watch the axis for the others",
    )
