"""`labrig devices check` of an axis with an EPOS2; nothing is written."""

from collections.abc import Iterator

from labrig.clock import Clock
from labrig.devices.bus import CanLink
from labrig.devices.can_description import HeartbeatDescription
from labrig.devices.check_result import CheckResult, CheckStatus, failed
from labrig.devices.cia402_check import (
    check_current,
    check_dead_man,
    check_inputs,
    check_limits,
    check_reference,
)
from labrig.devices.drive import Identity
from labrig.devices.epos2 import objects as od
from labrig.devices.epos2.driver import UNKNOWN_MODEL, Epos2
from labrig.devices.epos2.settings import Epos2Axis, drive_settings, fingerprint
from labrig.errors import LabrigError


def check_axis(
    link: CanLink, axis: Epos2Axis, name: str, clock: Clock, heartbeat: HeartbeatDescription
) -> Iterator[CheckResult]:
    """Compare an axis of the rig file with its drive."""
    drive = Epos2(link, axis, name, clock)
    try:
        identity = drive.read_identity()
        yield _identity_result(name, axis, identity)
        drive.raise_if_faulted()
        yield _encoder_result(name, axis, drive)
        if not axis.unknown:
            yield _configuration_result(name, axis, drive, heartbeat)
        yield check_dead_man(name, drive)
        yield check_reference(name, drive)
        yield check_limits(name, axis, drive)
        if not axis.unknown:
            yield check_current(name, axis, drive)
        yield from check_inputs(name, axis, drive)
    except LabrigError as error:
        yield failed(f"drive {name}", error)


def _identity_result(name: str, axis: Epos2Axis, identity: Identity) -> CheckResult:
    """Report model and versions; warn of a type or software whose objects nobody has compared with labrig's."""
    software = identity.versions["software_version"]
    value = (
        f"node {axis.node_id}: {identity.model}, hardware 0x{identity.versions['hardware_version']:04X}, "
        f"software 0x{software:04X}, serial {identity.serial_number}"
    )
    if identity.model == UNKNOWN_MODEL:
        return CheckResult(
            f"drive {name}",
            CheckStatus.WARN,
            f"{value}; it is used because the rig file names its hardware version",
            "check that its label says EPOS2; try homing, jog and the emergency stop without a needle first",
        )
    if software in od.TRIED_SOFTWARE:
        return CheckResult(f"drive {name}", CheckStatus.PASS, value)
    tried = " and ".join(f"0x{version:04X}" for version in sorted(od.TRIED_SOFTWARE))
    return CheckResult(
        f"drive {name}",
        CheckStatus.WARN,
        f"{value}; labrig knows the objects of software {tried}",
        "a run reads every setting back; try homing, jog and the emergency stop without a needle first",
    )


def _configuration_result(
    name: str, axis: Epos2Axis, drive: Epos2, heartbeat: HeartbeatDescription
) -> CheckResult:
    """Compare the fingerprint in the drive (0x1020) with that of the settings of the rig file."""
    found, expected = drive.fingerprint(), axis.configuration_fingerprint
    check, value = f"configuration {name}", f"fingerprint 0x{found[0]:08X}:{found[1]} (0x1020)"
    if found == (expected or fingerprint(drive_settings(axis, heartbeat))):
        return CheckResult(check, CheckStatus.PASS, f"{value}, as the rig file has it")
    if expected is not None:
        solution = (
            "with no needle in tissue, power the drive off and on; else compare it in EPOS Studio and enter the new "
            "fingerprint"
        )
        return CheckResult(
            check, CheckStatus.FAIL, f"{value}, the rig file says 0x{expected[0]:08X}:{expected[1]}", solution
        )
    if found == (0, 0):
        return CheckResult(check, CheckStatus.PASS, "not set up since power on; a run does so when it begins")
    return CheckResult(
        check,
        CheckStatus.WARN,
        f"{value}: set up for other settings than those of the rig file",
        "if somebody else uses this drive, ask; the next run writes what differs",
    )


def _encoder_result(name: str, axis: Epos2Axis, drive: Epos2) -> CheckResult:
    found, expected = drive.upload(od.ENCODER_PULSES), axis.encoder_pulses_per_turn
    if expected is None:
        value = f"the drive is set to {found} pulses a turn, the rig file says nothing"
        return CheckResult(
            f"encoder {name}", CheckStatus.WARN, value, "compare with the encoder's data sheet"
        )
    if found != expected:
        value = f"the drive is set to {found} pulses a turn, the rig file says {expected}"
        return CheckResult(
            f"encoder {name}", CheckStatus.FAIL, value, "correct the rig file, or the drive in EPOS Studio"
        )
    return CheckResult(f"encoder {name}", CheckStatus.PASS, f"{found} pulses a turn")
