"""What is in order with a rig and what is not, and what to do; no power is switched on, nothing moves."""

import shutil
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from datetime import datetime
from functools import partial
from pathlib import Path

import numpy as np

from labrig.devices import epos2_objects as od
from labrig.devices.camera import Camera
from labrig.devices.camera_kind import camera_kind
from labrig.devices.check_result import CheckResult, CheckStatus
from labrig.devices.cia402 import REFERENCED, decode_state
from labrig.devices.clocks import SystemClock
from labrig.devices.control import owner_of
from labrig.devices.drive_settings import drive_settings, fingerprint
from labrig.devices.epos2 import Epos2
from labrig.devices.motion_log import last_motion, motion_log_path
from labrig.devices.plant import Plant, make_plant
from labrig.devices.rig_file import (
    ONLY_SIMULATED,
    AxisDescription,
    HeartbeatDescription,
    RigDescription,
    unknown_entries,
)
from labrig.devices.state import StateStore
from labrig.errors import InputError, LabrigError
from labrig.vision.calibration_file import calibration_created, load_intrinsics, load_plane
from labrig.vision.intrinsics import Intrinsics
from labrig.vision.mask import load_mask
from labrig.vision.plane import PlaneMap

_LOW_DISK_BYTES = 5e9
_NO_DISK_BYTES = 5e8
_CALIBRATE = "labrig run protocols/calibration.yaml --rig FILE, then labrig calibrate adopt RUN --rig FILE"
_DRAW_MASK = "name a picture of the camera's size, white where no needle is, or polygons; or leave mask: out"
_OLD_DAYS = 30


def check_rig(rig: RigDescription) -> list[CheckResult]:
    """Check bus, drives, camera, calibration, disk and state of a rig.

    What cannot be reached is a result as well; this raises nothing for it.
    """
    results = [
        CheckResult(key, CheckStatus.FAIL, "unknown", f"enter it: {w}")
        for key, w in unknown_entries(rig).items()
    ]
    owner = owner_of(rig)
    if owner:
        value = f"in use by {owner}: bus, drives and camera are not looked at"
        solution = "wait until it has ended, or: labrig devices stop --rig FILE"
        results.append(CheckResult("rig", CheckStatus.WARN, value, solution))
    else:
        results += _device_results(rig)
    now = SystemClock().utc()
    return [*results, *check_calibration(rig, now), _disk_result(), _state_result(rig), *_motion_results(rig)]


def _device_results(rig: RigDescription) -> list[CheckResult]:
    try:
        plant = make_plant(rig, seed=0)
    except LabrigError as error:
        return [_failed("rig", error)]
    with ExitStack() as stack:
        stack.callback(plant.close)
        return [*_bus_results(rig, plant, stack), *_camera_results(rig, plant, stack)]


def _failed(check: str, error: LabrigError) -> CheckResult:
    return CheckResult(check, CheckStatus.FAIL, error.message, error.hint)


def _bus_results(rig: RigDescription, plant: Plant, stack: ExitStack) -> Iterator[CheckResult]:
    where = f"{rig.can.interface} {rig.can.channel}".strip()
    try:
        link = plant.open_link()
    except LabrigError as error:
        yield _failed("bus", error)
        for name, axis in rig.axes.items():
            yield CheckResult(
                f"drive {name}", CheckStatus.FAIL, f"node {axis.node_id} not reached", "see bus"
            )
        return
    stack.callback(link.close)
    yield CheckResult("bus", CheckStatus.PASS, f"{where}, {rig.can.bitrate} bit/s")
    for name, axis in rig.axes.items():
        yield from check_axis(
            name,
            axis,
            Epos2(link, axis.node_id, name, plant.clock, axis.encoder_pulses_per_turn),
            rig.can.heartbeat,
        )


def check_axis(
    name: str, axis: AxisDescription, drive: Epos2, heartbeat: HeartbeatDescription
) -> Iterator[CheckResult]:
    """Check what an axis and its drive say of each other."""
    try:
        identity = drive.identify()
        yield CheckResult(
            f"drive {name}",
            CheckStatus.PASS,
            f"node {axis.node_id}: {identity.model}, hardware 0x{identity.hardware_version:04X}, "
            f"software 0x{identity.software_version:04X}, serial {identity.serial_number}",
        )
        drive.raise_if_faulted()
        yield _encoder_result(name, axis, drive)
        if not axis.unknown:
            yield _configuration_result(name, axis, drive, heartbeat)
        yield _reference_result(name, drive)
        yield _limits_result(name, axis, drive)
    except LabrigError as error:
        yield _failed(f"drive {name}", error)


def _configuration_result(
    name: str, axis: AxisDescription, drive: Epos2, heartbeat: HeartbeatDescription
) -> CheckResult:
    """Compare the fingerprint in the drive (0x1020) with that of the settings of the rig file."""
    found, said = drive.fingerprint(), axis.configuration_fingerprint
    check, value = f"configuration {name}", f"fingerprint 0x{found[0]:08X}:{found[1]} (0x1020)"
    if found == (said or fingerprint(drive_settings(axis, heartbeat))):
        return CheckResult(check, CheckStatus.PASS, f"{value}, as the rig file has it")
    if said is not None:
        solution = "power the drive off and on; else compare it in EPOS Studio and enter the new fingerprint"
        return CheckResult(
            check, CheckStatus.FAIL, f"{value}, the rig file says 0x{said[0]:08X}:{said[1]}", solution
        )
    if found == (0, 0):
        return CheckResult(check, CheckStatus.PASS, "not set up since power on; a run does so when it begins")
    return CheckResult(
        check,
        CheckStatus.WARN,
        f"{value}: set up for other settings than those of the rig file",
        "if somebody else uses this drive, ask; the next run writes what differs",
    )


def _limits_result(name: str, axis: AxisDescription, drive: Epos2) -> CheckResult:
    """Compare the limits that the drive holds with those of the rig file; without a reference it holds none."""
    low, high = axis.limits
    value = f"[{low:g}, {high:g}] {axis.unit}, {axis.max_speed:g} {axis.unit}/s"
    if axis.unknown or not drive.is_referenced():
        return CheckResult(
            f"limits {name}", CheckStatus.PASS, f"{value}; the drive has none until referenced"
        )
    scale = axis.scale()
    margin = scale.to_distance_quadcounts(axis.position_window)
    lower, upper = sorted(map(scale.to_quadcounts, axis.limits))
    found = (drive.read(od.LOWER_LIMIT), drive.read(od.UPPER_LIMIT))
    if found == (lower - margin, upper + margin):
        return CheckResult(f"limits {name}", CheckStatus.PASS, f"{value}, also in the drive")
    return CheckResult(
        f"limits {name}",
        CheckStatus.WARN,
        f"{value}; the drive holds {found[0]} to {found[1]} quadcounts",
        f"reference the axis again: labrig devices home --axis {name} --rig FILE",
    )


def _encoder_result(name: str, axis: AxisDescription, drive: Epos2) -> CheckResult:
    found, said = drive.read(od.ENCODER_PULSES), axis.encoder_pulses_per_turn
    if said is None:
        value = f"the drive is set to {found} pulses a turn, the rig file says nothing"
        return CheckResult(
            f"encoder {name}", CheckStatus.WARN, value, "compare with the encoder's data sheet"
        )
    if found != said:
        value = f"the drive is set to {found} pulses a turn, the rig file says {said}"
        return CheckResult(
            f"encoder {name}", CheckStatus.FAIL, value, "correct the rig file, or the drive in EPOS Studio"
        )
    return CheckResult(f"encoder {name}", CheckStatus.PASS, f"{found} pulses a turn")


def _reference_result(name: str, drive: Epos2) -> CheckResult:
    statusword = drive.statusword()
    state = decode_state(statusword).name
    if statusword & REFERENCED:
        return CheckResult(f"reference {name}", CheckStatus.PASS, f"referenced, {state}")
    return CheckResult(
        f"reference {name}",
        CheckStatus.WARN,
        f"not referenced, {state}",
        f"a run asks for zero before it moves; or: labrig devices home --axis {name} --rig FILE",
    )


def _camera_results(rig: RigDescription, plant: Plant, stack: ExitStack) -> Iterator[CheckResult]:
    try:
        source = plant.open_source()
        stack.callback(source.close)
        camera = Camera(source, rig.camera, plant.clock)
        yield CheckResult(
            "camera settings",
            CheckStatus.PASS,
            ", ".join(f"{k} {v}" for k, v in camera.settings.readback.items()),
        )
        yield from camera_kind(rig.camera).check(rig.camera, camera)
    except LabrigError as error:
        yield _failed("camera", error)


def check_calibration(rig: RigDescription, now: datetime | None = None) -> Iterator[CheckResult]:
    """Check that the rig's calibration is there, was accepted, and is of this camera's picture size."""
    paths = rig.calibration_paths()
    intrinsics: list[Intrinsics] = []

    def lens(path: Path) -> str:
        found = load_intrinsics(path)
        _require_usable(rig, found)
        intrinsics.append(found)
        return f"{path.name}: {found.image_size[0]}x{found.image_size[1]} px, rms {found.rms_px:.3f} px"

    def plane(path: Path) -> str:
        found = load_plane(path, intrinsics[0] if intrinsics else None)
        _require_usable(rig, found)
        return f"{path.name}: {found.mm_per_px:.4f} mm/px"

    for name, describe in (("intrinsics.json", lens), ("plane.json", plane)):
        which, path = name.removesuffix(".json"), paths.get(name)
        result = _calibration_result(which, path, describe)
        yield result
        if now is not None and path is not None and result.status is CheckStatus.PASS:
            yield _age_result(which, path, now, moves=rig.kind != ONLY_SIMULATED)
    for path in rig.mask_paths().values():
        yield _calibration_result("mask", path, partial(_described_mask, rig), _DRAW_MASK)


def _described_mask(rig: RigDescription, path: Path) -> str:
    """Say which part of the camera's picture a mask takes away."""
    size = (rig.camera.height_px, rig.camera.width_px)
    masked = load_mask(path).masked("", np.zeros(size, np.uint8))
    share = 0.0 if masked is None else 100.0 * float(masked.mean())
    return f"{path.name}: {share:.1f} % of the picture is not the needle"


def _age_result(which: str, path: Path, now: datetime, *, moves: bool) -> CheckResult:
    """Tell how old a calibration is; a bench's camera is touched sooner or later."""
    check, again = f"calibration {which} age", "calibrate again where the camera or its lens has been touched"
    made = calibration_created(path)
    if made is None:
        return CheckResult(check, CheckStatus.WARN, "when it was made is not known", again)
    days = (now - made).days
    old = moves and days > _OLD_DAYS
    return CheckResult(
        check,
        CheckStatus.WARN if old else CheckStatus.PASS,
        f"{days} days, made {made:%Y-%m-%d}",
        again if old else "",
    )


def _calibration_result(
    which: str, path: Path | None, describe: Callable[[Path], str], solution: str = _CALIBRATE
) -> CheckResult:
    check = f"calibration {which}"
    if path is None or not path.is_file():
        value = "none named in the rig file" if path is None else f"{path} does not exist"
        return CheckResult(check, CheckStatus.FAIL, value, solution)
    try:
        return CheckResult(check, CheckStatus.PASS, describe(path))
    except LabrigError as error:
        return CheckResult(check, CheckStatus.FAIL, error.message, error.hint or solution)


def _require_usable(rig: RigDescription, found: Intrinsics | PlaneMap) -> None:
    """Refuse a calibration that was refused when it was made, or made for pictures of another size."""
    if not found.accepted:
        raise InputError(
            f"refused when it was made: {'; '.join(found.reasons)}", "calibrate again as this says"
        )
    camera, size = (rig.camera.width_px, rig.camera.height_px), found.image_size
    if size is not None and size != camera:
        raise InputError(
            f"made for {size[0]}x{size[1]} px, the camera gives {camera[0]}x{camera[1]} px",
            "calibrate again at this size",
        )


def _disk_result() -> CheckResult:
    free = shutil.disk_usage(Path.cwd()).free
    status = (
        CheckStatus.FAIL
        if free < _NO_DISK_BYTES
        else CheckStatus.WARN
        if free < _LOW_DISK_BYTES
        else CheckStatus.PASS
    )
    return CheckResult(
        "disk", status, f"{free / 1e9:.1f} GB free here", "" if status is CheckStatus.PASS else "make room"
    )


def _state_result(rig: RigDescription) -> CheckResult:
    state = StateStore(rig.state_path).state
    if state.needle_in_tissue is False:
        return CheckResult("rig state", CheckStatus.PASS, "no needle in tissue")
    status = CheckStatus.FAIL if state.needle_in_tissue else CheckStatus.WARN
    return CheckResult("rig state", status, state.doubt, state.way_out)


def _motion_results(rig: RigDescription) -> Iterator[CheckResult]:
    """Tell what was last homed or jogged; whoever comes back to a bench wants to know."""
    last = None if rig.state_path is None else last_motion(rig.state_path)
    if rig.state_path is None or last is None:
        return
    position = last["position"]
    stood = f"at {position:.4g} {last['unit']}" if isinstance(position, float) else "somewhere"
    value = (
        f"axis {last['axis']} {stood}, {last['what']}, {last.get('outcome', 'never ended')}, {last['utc']}"
    )
    yield CheckResult(
        "last motion by hand", CheckStatus.PASS, f"{value}; see {motion_log_path(rig.state_path).name}"
    )
