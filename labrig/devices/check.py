"""Checks a rig and says what to do about problems; no power is switched on, and nothing moves."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from functools import partial
from pathlib import Path

import numpy as np

from labrig.clock import Clock
from labrig.devices.bus import CanLink
from labrig.devices.bus_watch import BusWatch
from labrig.devices.camera import Camera, require_calibrated_camera
from labrig.devices.check_result import CheckResult, CheckStatus, failed, passed, warned
from labrig.devices.drives.check import check_axis
from labrig.devices.exclusive import acquire_rig
from labrig.devices.hardware import Hardware, make_hardware
from labrig.devices.needle_state import load_state
from labrig.devices.rig_file import RigDescription, find_problems
from labrig.errors import InputError, LabrigError, LockedError, OutputExistsError, SecondMasterError
from labrig.vision.calibration_file import load_intrinsics, load_plane
from labrig.vision.intrinsics import Intrinsics
from labrig.vision.picture import load_mask, require_size, size_of
from labrig.vision.plane import PlaneMap
from labrig.vision.template import load_template

_DRAW_MASK = "name a picture of the camera's size, white where no needle is, or leave mask: out"


def check_rig(rig: RigDescription) -> list[CheckResult]:
    """Check bus, drives, camera, calibration and state of a rig.

    A device that cannot be reached is a failed result, not an error.
    """
    return [
        *(CheckResult(each.where, CheckStatus.FAIL, each.message, each.hint) for each in find_problems(rig)),
        *_check_devices(rig),
        *check_calibration(rig),
        *_check_template(rig),
        _check_state(rig),
    ]


def _check_devices(rig: RigDescription) -> list[CheckResult]:
    """Check bus, drives and camera while no other labrig can use them."""
    with ExitStack() as stack:
        try:
            stack.enter_context(acquire_rig(rig, "labrig devices check"))
            hardware = make_hardware(rig, seed=0)
        except LockedError as error:
            return [warned("rig", f"{error.message}: bus, drives and camera are not looked at", error.hint)]
        except LabrigError as error:
            return [failed("rig", error)]
        stack.callback(hardware.close)
        return [*check_bus(rig, hardware, stack), *_check_camera(rig, hardware, stack)]


def check_bus(rig: RigDescription, hardware: Hardware, stack: ExitStack) -> Iterator[CheckResult]:
    """Check the CAN bus of a rig and its drives; `stack` closes the bus."""
    where = f"{rig.can.interface} {rig.can.channel}".strip()
    try:
        link = hardware.open_link()
    except LabrigError as error:
        yield failed("bus", error)
        return
    stack.callback(link.close)
    yield _listen(rig, link, hardware.clock, f"{where}, {rig.can.bitrate} bit/s")
    for name, axis in rig.axes.items():
        yield from check_axis(link, axis, name, hardware.clock)


def _listen(rig: RigDescription, link: CanLink, clock: Clock, bus: str) -> CheckResult:
    """Listen for another master: no rig is opened beside one."""
    nodes = {axis.node_id: name for name, axis in rig.axes.items()}
    try:
        BusWatch(link, nodes, rig.can.heartbeat).listen(clock)
    except SecondMasterError as error:
        return warned("bus", f"{bus}; {error.message}", error.hint)
    return passed("bus", bus)


def _check_camera(rig: RigDescription, hardware: Hardware, stack: ExitStack) -> Iterator[CheckResult]:
    try:
        source = hardware.open_source()
        stack.callback(source.close)
        camera = Camera(source, rig.camera, hardware.clock)
        yield passed("camera settings", ", ".join(f"{k} {v}" for k, v in camera.settings.items()))
        frame = camera.capture()
        height, width = frame.image.shape[:2]
        recorded = (
            f", recorded pictures of {rig.camera.address}: they never steer" if rig.camera.recorded else ""
        )
        yield passed("camera picture", f"{width}x{height} px{recorded}")
        if frame.t_bound_s is not None:
            value = f"known within {1000 * frame.t_bound_s:.0f} ms, {frame.t_bound_s:.2f} mm at 1 mm/s"
            yield passed("camera time", value)
        for path in rig.calibration_paths().values():
            require_calibrated_camera(rig.camera, path, camera.settings)
    except LabrigError as error:
        yield failed("camera", error)


def check_calibration(rig: RigDescription) -> Iterator[CheckResult]:
    """Check that the rig's calibration is there, was accepted, and is of this camera's picture size and settings."""
    intrinsics = list[Intrinsics]()
    how = f"labrig run protocols/calibration.yaml {rig.option}, then labrig calibrate adopt RUN {rig.option}"

    def lens(path: Path) -> str:
        found = load_intrinsics(path)
        intrinsics.append(found)  # the plane is judged on its own, also if this one cannot be used
        _require_usable(rig, found, path)
        return f"{path.name}: {found.image_size[0]}x{found.image_size[1]} px, rms {found.rms_px:.3f} px"

    def plane(path: Path) -> str:
        found = load_plane(path, intrinsics[0] if intrinsics else None)
        _require_usable(rig, found, path)
        return ". ".join(filter(None, (f"{path.name}: {found.mm_per_px:.4f} mm/px", found.view_sentence())))

    yield _check_calibration_file(rig, "intrinsics", lens, how)
    yield _check_calibration_file(rig, "plane", plane, how)
    if rig.calibration.mask is not None:
        yield _check_calibration_file(rig, "mask", partial(_describe_mask, rig), _DRAW_MASK)


def _check_template(rig: RigDescription) -> Iterator[CheckResult]:
    """Check the template of the tip, if one is named: only what steers needs it."""
    if rig.calibration.template is not None:
        yield _check_calibration_file(rig, "template", _describe_tip, "labrig calibrate template makes one")


def _describe_tip(path: Path) -> str:
    """Return where the tip is in a template."""
    return "{}: tip at ({:.1f}, {:.1f}) px".format(path.name, *load_template(path).tip_px)


def _describe_mask(rig: RigDescription, path: Path) -> str:
    """Return the share of the camera's picture that a mask excludes."""
    masked = load_mask(path)
    size = (rig.camera.height_px, rig.camera.width_px)
    require_size(np.zeros(size, np.uint8), size_of(masked), f"the mask {path.name}")
    return f"{path.name}: {100.0 * float(masked.mean()):.1f} % of the picture is not the needle"


def _check_calibration_file(
    rig: RigDescription, kind: str, describe: Callable[[Path], str], solution: str
) -> CheckResult:
    check, path = f"calibration {kind}", rig.calibration_file(kind)
    if path is None or not path.is_file():
        value = "none named in the rig file" if path is None else f"{path} does not exist"
        return CheckResult(check, CheckStatus.FAIL, value, solution)
    try:
        return passed(check, describe(path))
    except LabrigError as error:
        return CheckResult(check, CheckStatus.FAIL, error.message, error.hint or solution)


def _require_usable(rig: RigDescription, found: Intrinsics | PlaneMap, path: Path) -> None:
    """Refuse a calibration that was rejected when it was made, or is for another picture size, format or focus."""
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
    require_calibrated_camera(rig.camera, path, rig.camera.settings())


def _check_state(rig: RigDescription) -> CheckResult:
    try:
        state = load_state(rig.state_path)
    except OutputExistsError as error:
        return failed("rig state", error)
    if state.needle_in_tissue is False:
        return passed("rig state", "no needle in tissue")
    status = CheckStatus.FAIL if state.needle_in_tissue else CheckStatus.WARN
    return CheckResult("rig state", status, state.doubt, state.find_way_out(rig.option))
