"""The simulated camera: draws what the world shows, with its exposure and gain."""

from typing import ClassVar, Literal

from labrig.clock import Clock
from labrig.devices.camera import (
    CameraContext,
    ControlledCameraDescription,
    Exposure,
    RigKind,
    Setting,
)
from labrig.simulation.world import World

REFERENCE_EXPOSURE_US = 8000.0
"""Exposure at gain 0 with which clear gel is as bright as the world's light says."""

_GAIN_STEPS_A_DOUBLING = 64.0
_POWER_ON: dict[str, Setting] = {
    "pixel_format": "GREY",
    "width_px": 640,
    "height_px": 480,
    "rate_hz": 30.0,
    "mains_hz": 60,
    "exposure_us": 15_600,
    "gain": 32,
    "white_balance_k": 4600,
    "focus": 0,
}


class SimulatedSource:
    """Takes every setting except those that the world's description lists as ignored.

    Parameters
    ----------
    world : World
        What is drawn.
    clock : Clock
        Rig time; the world is where it has brought the axes.
    """

    def __init__(self, world: World, clock: Clock) -> None:
        self._world = world
        self._clock = clock
        self._settings = dict(_POWER_ON)

    def set(self, name: str, value: Setting) -> None:
        """Make a setting, or ignore it silently."""
        if name not in self._world.description.ignores:
            self._settings[name] = value

    def get(self, name: str) -> Setting | None:
        """Return the value in use."""
        return self._settings.get(name)

    def read(self) -> Exposure:
        """Draw a picture; if time passes by itself, with the time of what it shows."""
        asked_s = self._clock.now_s()
        self._clock.sleep(0.0)  # brings the axes to where they are now
        t_s = self._clock.now_s()
        exposure, gain = self._settings["exposure_us"], self._settings["gain"]
        light = float(exposure) / REFERENCE_EXPOSURE_US * 2 ** (float(gain) / _GAIN_STEPS_A_DOUBLING)
        picture = self._world.picture(light)
        return Exposure(picture) if t_s == asked_s else Exposure(picture, t_s, t_bound_s=t_s - asked_s)

    def close(self) -> None:
        """Nothing to release."""


class SimulatedCameraDescription(ControlledCameraDescription):
    """The simulated camera, which has the settings of a UVC camera."""

    rig_kinds: ClassVar[frozenset[RigKind]] = frozenset({"simulated"})

    driver: Literal["simulated"]
    """simulated: draws what the rig's world shows."""

    def open(self, context: CameraContext) -> SimulatedSource:
        """Return a camera that sees the world."""
        assert context.world is not None  # by `rig_kinds`
        return SimulatedSource(context.world, context.clock)


CAMERA = SimulatedCameraDescription
"""What the entry point names."""
