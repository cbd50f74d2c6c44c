"""The simulated camera: draws what the world shows, with the exposure and gain that it has been set to."""

from labrig.devices.camera import Picture, Setting
from labrig.simulation import World

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
    """Takes every setting, but for those that the world's description says it ignores.

    Parameters
    ----------
    world : World
        What is drawn.
    """

    exposures_a_picture = 1

    def __init__(self, world: World) -> None:
        self._world = world
        self._settings = dict(_POWER_ON)

    def set(self, name: str, value: Setting) -> None:
        """Make a setting, or ignore it without a word."""
        if name not in self._world.description.ignores:
            self._settings[name] = value

    def get(self, name: str) -> Setting | None:
        """Return the value in use."""
        return self._settings.get(name)

    def read(self) -> Picture | None:
        """Draw a picture."""
        exposure, gain = self._settings["exposure_us"], self._settings["gain"]
        light = float(exposure) / REFERENCE_EXPOSURE_US * 2 ** (float(gain) / _GAIN_STEPS_A_DOUBLING)
        return self._world.picture(light)

    def close(self) -> None:
        """Nothing is held."""
