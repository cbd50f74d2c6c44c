"""The section `camera` of the rig file: what every camera has, and the settings of one that has controls."""

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from labrig.protocol.model import Model

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

    rig_kinds: ClassVar[frozenset[RigKind]] = frozenset({"bench"})
    """Kinds of rig that may have such a camera."""

    recorded: ClassVar[bool] = False
    """Whether its pictures were recorded before, so that they do not show what the needle does now."""

    driver: str = Field(description="Driver of the camera, as an installed package names it.")
    width_px: Annotated[int, Field(ge=16, le=10_000)] = Field(description="Width of a picture [px].")
    height_px: Annotated[int, Field(ge=16, le=10_000)] = Field(description="Height of a picture [px].")
    rate_hz: Annotated[float, Field(gt=0, le=1000)] = Field(description="Pictures a second [Hz].")
    store: Literal["png", "raw"] = Field(
        "png",
        description="How pictures are recorded: a PNG each, or all in frames.raw, for a camera too fast for PNG.",
    )

    @property
    def address(self) -> str:
        """Where the camera is found, as records and messages show it; empty where there is but one."""
        return ""

    def settings(self) -> dict[str, Setting]:
        """Return the settings to be made, in the order in which a camera takes them."""
        return {"width_px": self.width_px, "height_px": self.height_px, "rate_hz": self.rate_hz}

    def reported(self) -> tuple[str, ...]:
        """Return the settings that are not made, and that the camera is asked for all the same."""
        return ()


class ControlledCameraDescription(CameraDescription):
    """A camera whose exposure and image processing are set through controls, as UVC cameras have them."""

    device: Annotated[str, Field(max_length=200)] = Field("", description="Device file, such as /dev/video0.")
    pixel_format: Annotated[str, Field(min_length=4, max_length=4)] = Field(
        description="Four characters: MJPG, YUYV, GREY; simulated cameras have GREY."
    )
    exposure_us: Annotated[int, Field(ge=100, le=1_000_000)] | None = Field(
        description="Exposure, automatic off; UVC cameras take multiples of 100. null: it cannot be set [us]."
    )
    gain: Annotated[int, Field(ge=0, le=100_000)] | None = Field(
        description="Gain in the camera's own steps, automatic off. null: the camera has none [-]."
    )
    white_balance_k: Annotated[int, Field(ge=1000, le=20_000)] | None = Field(
        description="White balance, automatic off. null: the camera has none [K]."
    )
    focus: Annotated[int, Field(ge=0, le=100_000)] | None = Field(
        description="Focus in the camera's own steps, automatic off. null: the lens is turned by hand [-]."
    )
    mains_hz: Literal[0, 50, 60] | None = Field(
        description="Mains frequency whose flicker is filtered, 0 for none. null: the camera has no filter [Hz]."
    )

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

    def reported(self) -> tuple[str, ...]:
        """Return the focus where it is not set: an autofocus would change it unseen."""
        return ("focus",) if self.focus is None else ()
