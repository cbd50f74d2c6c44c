"""The camera: its section of the rig file, its settings, and whether pictures are what the file promises.

An entry point of the group `labrig.cameras` names the class of such a section.
"""

import math
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar, Literal, Protocol, TypeVar

import numpy as np
import numpy.typing as npt
from pydantic import Field

from labrig.clock import Clock
from labrig.devices.worker import SAME_THREAD, StillBusyError, Worker
from labrig.errors import CameraError, InputError
from labrig.plugins import INTERFACE
from labrig.protocol.model import Model
from labrig.simulation.world import World
from labrig.vision.calibration_file import read_camera

Picture = npt.NDArray[np.uint8]

RigKind = Literal["simulated", "bench"]

Setting = str | float
"""Value of a camera setting."""


CONTROL_NAMES = ("mains_hz", "exposure_us", "gain", "white_balance_k", "focus")
"""Settings that a camera may lack, and that are then null, in the order in which a camera takes them."""


HELD_BY_CALIBRATION = ("pixel_format", "focus")
"""Settings that decide where a point falls in the picture, besides its size, which a calibration states itself. The
others change brightness, colour and rate."""


class CameraDescription(Model):
    """The camera and each of its settings; one that it does not take, or does not read back, is refused."""

    interface: ClassVar[int] = INTERFACE
    """Version of the interface for which it is written."""

    rig_kinds: ClassVar[frozenset[RigKind]] = frozenset({"bench"})
    """Kinds of rig that may have such a camera."""

    recorded: ClassVar[bool] = False
    """Whether its pictures were recorded before, so that they do not show what the needle does now."""

    driver: str
    """Driver of the camera, as an installed package names it."""
    width_px: Annotated[int, Field(ge=16, le=10_000)]
    """Width of a picture [px]."""
    height_px: Annotated[int, Field(ge=16, le=10_000)]
    """Height of a picture [px]."""
    rate_hz: Annotated[float, Field(gt=0, le=1000)]
    """Pictures a second [Hz]."""
    distance_mm: Annotated[float, Field(gt=0, le=10_000)] | None = None
    """Distance from the camera to the needle's plane by tape, to 20 % [mm]: with the lens it tells the scale of graph
    paper; null: that of the last plane map."""
    store: Literal["png", "pgm"] = "png"
    """How pictures are recorded: as PNG, or as PGM (PPM in colour) for a camera too fast for PNG."""

    @property
    def address(self) -> str:
        """Where the camera is found, as records and messages show it; empty where there is but one."""
        return ""

    def settings(self) -> dict[str, Setting]:
        """Return the settings to be made, in the order in which a camera takes them."""
        return {"width_px": self.width_px, "height_px": self.height_px, "rate_hz": self.rate_hz}

    def open(self, context: "CameraContext") -> "PictureSource":
        """Open the camera. Raises `CameraError` when there is none."""
        raise NotImplementedError


class ControlledCameraDescription(CameraDescription):
    """A camera whose exposure and image processing are set through controls, as UVC cameras have them."""

    device: Annotated[str, Field(max_length=200)] = ""
    """Device file, such as /dev/video0."""
    pixel_format: Annotated[str, Field(min_length=4, max_length=4)]
    """Four characters: MJPG, YUYV, GREY; simulated cameras have GREY."""
    exposure_us: Annotated[int, Field(ge=100, le=1_000_000)] | None
    """Exposure, automatic off; UVC cameras take multiples of 100. null: it cannot be set [us]."""
    gain: Annotated[int, Field(ge=0, le=100_000)] | None
    """Gain in the camera's own steps, automatic off. null: the camera has none [-]."""
    white_balance_k: Annotated[int, Field(ge=1000, le=20_000)] | None
    """White balance, automatic off. null: the camera has none [K]."""
    focus: Annotated[int, Field(ge=0, le=100_000)] | None
    """Focus in the camera's own steps, automatic off. null: the lens is turned by hand [-]."""
    mains_hz: Literal[0, 50, 60] | None
    """Mains frequency whose flicker is filtered, 0 for none. null: the camera has no filter [Hz]."""

    @property
    def address(self) -> str:
        """The device file."""
        return self.device

    @property
    def longest_exposure_s(self) -> float:
        """The exposure, or the time between two pictures if the exposure is not known [s]."""
        return 1 / self.rate_hz if self.exposure_us is None else self.exposure_us / 1e6

    def settings(self) -> dict[str, Setting]:
        """Return the settings to be made, in the order in which a camera takes them."""
        values = {
            "pixel_format": self.pixel_format,
            **super().settings(),
            **{name: getattr(self, name) for name in CONTROL_NAMES},
        }
        return {name: value for name, value in values.items() if value is not None}


_T = TypeVar("_T")

_RATE_TOLERANCE = 0.01
"""Cameras state their rate as a fraction of integers; some report 29.97 for 30 Hz."""

_MICROSECOND_S = 1e-6

_PATIENCE_S, _PATIENCE_PICTURES = 3.0, 10
"""A camera hangs that has given no picture for this time and that of so many pictures [s]."""

_MOVED_MM = 0.5
"""Travel after which a picture must differ from the one before."""


def _do_nothing() -> None:
    """Nobody supervises: no drive has power."""


@dataclass(frozen=True, eq=False)
class Exposure:
    """A picture from its source, (H, W) or (H, W, 3) uint8, with what the source knows about its time.

    Attributes
    ----------
    t_s : float or None
        Rig time [s] of the exposure; None means the time of the call.
    t_bound_s : float or None
        Bound of the error of `t_s` [s]; None if `t_s` is.
    """

    image: Picture
    t_s: float | None = None
    t_bound_s: float | None = None


class PictureSource(Protocol):
    """Source of pictures: the driver of a camera, or a simulated camera."""

    def set(self, name: str, value: Setting) -> None:
        """Request a setting, which the source may ignore. Raises `CameraError` if it has no such setting."""

    def get(self, name: str) -> Setting | None:
        """Return the value that the source uses now; None if it cannot tell."""

    def read(self) -> Exposure | None:
        """Return a picture exposed after this call, or None if none comes."""

    def close(self) -> None:
        """Release the camera; a second call changes nothing."""


@dataclass(frozen=True, eq=False)
class Frame:
    """A picture, (H, W) or (H, W, 3) uint8, the rig time [s] at which it was taken, and the bound of its error."""

    image: Picture
    t_s: float
    t_bound_s: float | None = None

    def place_between(self, before_s: float, after_s: float) -> tuple[float | None, float | None]:
        """Return its place between two encoder readings at these rig times [s], 0 to 1, and the bound of its time [s].

        If the exposure lies outside them, its distance to the nearer one is added to its bound. Both are None where its
        time is that of the call.
        """
        if self.t_bound_s is None or after_s <= before_s:
            return None, self.t_bound_s
        nearest_s = min(max(self.t_s, before_s), after_s)
        return (nearest_s - before_s) / (after_s - before_s), self.t_bound_s + abs(self.t_s - nearest_s)


class Camera:
    """A camera that has accepted all its settings.

    Parameters
    ----------
    source : PictureSource
        Source of the pictures.
    description : CameraDescription
        Its section of the rig file.
    clock : Clock
        Stamps the frames.
    worker : Worker
        Asks the source from now on.

    Attributes
    ----------
    settings : dict
        Every setting that is known: those that were made, as read back, and those that it reports without a request.

    Raises
    ------
    CameraError
        When a setting is not accepted; names it, the requested value and the one in use.
    """

    def __init__(
        self,
        source: PictureSource,
        description: CameraDescription,
        clock: Clock,
        worker: Worker = SAME_THREAD,
    ) -> None:
        self._source = source
        self._clock = clock
        self._worker = worker
        self._name = f"the camera {description.address}".strip()
        self._limit_s = _PATIENCE_S + _PATIENCE_PICTURES / description.rate_hz
        self._hanging: CameraError | None = None
        self._shape = (description.height_px, description.width_px)
        self._description = description
        self._shown: tuple[bytes, tuple[float, float]] | None = None
        self.settings = _make_settings(source, description)

    def describe(self) -> dict[str, object]:
        """Return the camera and its settings, ready for JSON."""
        asked = self._description.settings()
        reported = {name: value for name, value in self.settings.items() if name not in asked}
        return {
            "driver": self._description.driver,
            "device": self._description.address,
            **({"recorded_pictures": True} if self._description.recorded else {}),
            "asked": asked,
            "readback": {name: self.settings[name] for name in asked},
            **({"reported": reported} if reported else {}),
        }

    def read_settings(self, meanwhile: Callable[[], None] = _do_nothing) -> dict[str, Setting | None]:
        """Return each setting that is known as it is now; None if the camera cannot tell. Raises `CameraError`."""
        return self._ask(lambda: {name: self._source.get(name) for name in self.settings}, meanwhile)

    def capture(self, meanwhile: Callable[[], None] = _do_nothing) -> Frame:
        """Take a picture, and call `meanwhile` again and again until it is there.

        Raises
        ------
        CameraError
            When none comes, or its size or depth is wrong.
        """
        asked_s = self._clock.now_s()
        exposure = self._ask(self._source.read, meanwhile)
        if exposure is None:
            raise CameraError(
                "the camera gave no picture", "check its cable and whether another program uses it"
            )
        image = exposure.image
        if image.dtype != np.uint8 or image.shape[:2] != self._shape or image.ndim not in {2, 3}:
            height, width = self._shape
            raise CameraError(
                f"the camera gave a picture of shape {image.shape} and type {image.dtype}, "
                f"expected {width}x{height} uint8",
                "check width_px, height_px and pixel_format in the rig file",
            )
        t_s = asked_s if exposure.t_s is None else round(exposure.t_s, 6)
        if t_s < asked_s - _MICROSECOND_S:
            raise CameraError(
                f"the camera gave a picture of {t_s:.3f} s, older than the command of {asked_s:.3f} s",
                "check the times of the pictures, or unplug the camera and plug it in again",
            )
        return Frame(image, t_s, exposure.t_bound_s)

    def _ask(self, call: Callable[[], _T], meanwhile: Callable[[], None]) -> _T:
        """Ask the source; a camera that hung once is not asked again. Raises `CameraError`."""
        if self._hanging is None:
            try:
                return self._worker.do(call, meanwhile, self._limit_s)
            except StillBusyError:
                self._hanging = CameraError(
                    f"{self._name} hangs: it has not answered for {self._limit_s:.1f} s",
                    "unplug the camera and plug it in again",
                )
        raise self._hanging

    def require_new(self, frame: Frame, place_mm: tuple[float, float]) -> None:
        """Refuse a camera that repeats a picture: two real exposures are never identical.

        Parameters
        ----------
        frame : Frame
            The newest picture.
        place_mm : tuple of float
            Positions of needle and sheath. A repeated picture is accepted while they stand still, as in simulated
            worlds without noise.

        Raises
        ------
        CameraError
        """
        # A copy: a camera may write the next picture into the same memory. Two pictures differ in their first pixels,
        # so that comparing them is faster than hashing this one.
        shown = frame.image.tobytes()
        if self._shown is None or self._shown[0] != shown:
            self._shown = (shown, place_mm)
        elif math.dist(self._shown[1], place_mm) > _MOVED_MM:
            raise CameraError(
                f"the camera still gives the same picture after {math.dist(self._shown[1], place_mm):.3g} mm of travel",
                "unplug the camera and plug it in again",
            )


def close_source(source: PictureSource, worker: Worker) -> None:
    """Release a camera; one that hangs is left to the end of the process."""
    with suppress(StillBusyError):
        worker.do(source.close, _do_nothing, _PATIENCE_S)


def _make_settings(source: PictureSource, description: CameraDescription) -> dict[str, Setting]:
    """Make every setting, then read all of them back: a later one may have changed an earlier one.

    What a calibration depends on is read where it is not set too: an autofocus would change it unseen.
    """
    asked = description.settings()
    for name, value in asked.items():
        source.set(name, value)
    told = {name: source.get(name) for name in (*asked, *HELD_BY_CALIBRATION)}
    for name, value in asked.items():
        _require_made(name, value, told[name])
    return {name: value for name, value in told.items() if value is not None}


def _require_made(name: str, asked: Setting, got: Setting | None) -> None:
    if got is None:
        raise CameraError(
            f"the camera does not tell its {name}; {asked} was asked for",
            f"write camera.{name}: null if it has no such control"
            if name in CONTROL_NAMES
            else f"enter a {name} that the camera has in the rig file, or use another camera",
        )
    is_near = name == "rate_hz" and math.isclose(float(got), float(asked), rel_tol=_RATE_TOLERANCE)
    if got != asked and not is_near:
        raise CameraError(
            f"the camera ignored {name}: {asked} was asked for, it uses {got}",
            f"enter a value that the camera has in the rig file, or write camera.{name}: {got}",
        )


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


def require_calibrated_camera(camera: CameraDescription, path: Path, in_use: Mapping[str, Setting]) -> None:
    """Refuse a calibration that was made with another focus or format than the camera has now.

    A setting that only one of both knows, and a calibration that states no settings, cannot be compared. Pictures that
    were recorded before are those of another camera, whose settings are not known.

    Parameters
    ----------
    camera : CameraDescription
        Section of the camera.
    path : Path
        File of the calibration.
    in_use : Mapping
        Settings of the rig's camera now.

    Raises
    ------
    InputError
        Names the first setting that differs, its value then and its value now.
    """
    calibrated = None if camera.recorded else read_camera(path)
    made_with = {} if calibrated is None else calibrated.settings
    for name in HELD_BY_CALIBRATION:
        if name in made_with and name in in_use and made_with[name] != in_use[name]:
            raise InputError(
                f"{path.name} was made with camera.{name} {made_with[name]}, it is {in_use[name]} now",
                f"write camera.{name}: {made_with[name]} in the rig file, or calibrate again",
            )
