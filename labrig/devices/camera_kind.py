"""`CameraKind`: what a package declares by an entry point to add a kind of camera."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Generic, TypeVar

from labrig.clock import Clock
from labrig.devices.camera import Camera, PictureSource
from labrig.devices.camera_settings import CameraDescription
from labrig.devices.check_result import CheckResult, CheckStatus
from labrig.plugins import CAMERAS, find_plugin
from labrig.simulation.world import World

Section = TypeVar("Section", bound=CameraDescription)

_RATE_PICTURES = 6
_LEAST_RATE_FRACTION = 0.9


@dataclass(frozen=True)
class CameraContext:
    """The context in which a camera is opened.

    Attributes
    ----------
    clock : Clock
        Rig time.
    folder : Path
        Folder of the rig file, to which the file names of its sections are relative.
    world : World or None
        The world of a simulated rig; None on a bench.
    """

    clock: Clock
    folder: Path = Path()
    world: World | None = None


class CameraKind(Generic[Section]):
    """A kind of camera; the entry point names an instance.

    Attributes
    ----------
    name : str
        Name of the entry point, as in `camera.driver` of a rig file.
    interface : int
        Version of this interface for which it is written.
    settings : type of CameraDescription
        Model of its section of the rig file.
    """

    name: ClassVar[str]
    interface: ClassVar[int] = 1
    settings: type[Section]

    def open(self, section: Section, context: CameraContext) -> PictureSource:
        """Open the camera.

        Raises
        ------
        CameraError
            When there is no such camera.
        """
        raise NotImplementedError

    def check(self, section: Section, camera: Camera) -> Iterator[CheckResult]:
        """Yield the results of `devices check` for a camera with accepted settings. Raises `CameraError`."""
        frame = camera.capture()
        height, width = frame.image.shape[:2]
        yield CheckResult("camera picture", CheckStatus.PASS, f"{width}x{height} px")
        if frame.t_bound_s is not None:
            value = f"known within {1000 * frame.t_bound_s:.0f} ms, {frame.t_bound_s:.2f} mm at 1 mm/s"
            yield CheckResult("camera time", CheckStatus.PASS, value)
        yield check_rate(camera.measure_rate_hz(_RATE_PICTURES), section.rate_hz)


def find_camera_kind(name: str) -> CameraKind[Any]:
    """Return the kind of camera that has this name in rig files.

    Raises
    ------
    InputError
        When no installed package has one, or several have.
    PluginError
        When its package cannot be imported, is written for another interface, or declares something else.
    """
    return find_plugin(CAMERAS, name).load_as(CameraKind)


def check_rate(measured_hz: float | None, asked_hz: float) -> CheckResult:
    """Compare the measured rate of the camera with the requested one."""
    check = "camera rate"
    if measured_hz is None:
        return CheckResult(check, CheckStatus.PASS, f"{asked_hz:g} Hz asked; simulated pictures take no time")
    value = f"{measured_hz:.1f} Hz measured, {asked_hz:g} Hz asked"
    if measured_hz >= _LEAST_RATE_FRACTION * asked_hz:
        return CheckResult(check, CheckStatus.PASS, value)
    return CheckResult(
        check, CheckStatus.WARN, value, "shorten exposure_us, or use a USB port that no other camera shares"
    )
