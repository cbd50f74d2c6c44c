"""What is in order with a rig and what is not, and what to do; no power is switched on, nothing moves."""

import shutil
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

from labrig.devices import epos2_objects as od
from labrig.devices.bus import CanLink
from labrig.devices.camera import Camera
from labrig.devices.cia402 import REFERENCED, decode_state
from labrig.devices.epos2 import Epos2
from labrig.devices.plant import Plant, make_plant
from labrig.devices.rig_file import AxisDescription, RigDescription, unknown_entries
from labrig.devices.state import StateStore
from labrig.errors import InputError, LabrigError
from labrig.vision import Intrinsics, PlaneMap, load_intrinsics, load_plane

_LOW_DISK_BYTES = 5e9
_NO_DISK_BYTES = 5e8


class CheckStatus(StrEnum):
    """How a check came out."""

    PASS = "PASS"  # noqa: S105 - no password
    WARN = "WARN"
    FAIL = "FAIL"


@dataclass(frozen=True)
class CheckResult:
    """One check: what was looked at, how it came out, what was found, and what to do about it."""

    check: str
    status: CheckStatus
    value: str
    solution: str = ""


def check_rig(rig: RigDescription) -> list[CheckResult]:
    """Check bus, drives, camera, calibration, disk and state of a rig.

    What cannot be reached is a result as well; this raises nothing for it.
    """
    results = [
        CheckResult(key, CheckStatus.FAIL, "unknown", f"enter it: {w}")
        for key, w in unknown_entries(rig).items()
    ]
    try:
        plant = make_plant(rig, seed=0)
    except LabrigError as error:
        results.append(_failed("rig", error))
    else:
        with ExitStack() as stack:
            stack.callback(plant.close)
            results += _bus_results(rig, plant, stack)
            results += _camera_results(rig, plant, stack)
    return [*results, *check_calibration(rig), _disk_result(), _state_result(rig)]


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
        yield from check_axis(name, axis, plant, link)


def check_axis(name: str, axis: AxisDescription, plant: Plant, link: CanLink) -> Iterator[CheckResult]:
    """Check what an axis and its drive say of each other."""
    drive = Epos2(link, axis.node_id, name, plant.clock)
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
        yield _reference_result(name, drive)
    except LabrigError as error:
        yield _failed(f"drive {name}", error)
    low, high = axis.limits
    yield CheckResult(
        f"limits {name}",
        CheckStatus.PASS,
        f"[{low:g}, {high:g}] {axis.unit}, {axis.max_speed:g} {axis.unit}/s",
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
        "a run asks for zero before it moves",
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
        height, width = camera.capture().image.shape[:2]
        yield CheckResult("camera picture", CheckStatus.PASS, f"{width}x{height} px")
    except LabrigError as error:
        yield _failed("camera", error)


def check_calibration(rig: RigDescription) -> Iterator[CheckResult]:
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
        yield _calibration_result(name.removesuffix(".json"), paths.get(name), describe)


def _calibration_result(which: str, path: Path | None, describe: Callable[[Path], str]) -> CheckResult:
    check, solution = (
        f"calibration {which}",
        "labrig run protocols/calibration.yaml, then labrig calibrate adopt RUN",
    )
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
    return CheckResult(
        "rig state", status, state.doubt, "withdraw the needle; the next run asks to confirm that it is out"
    )
