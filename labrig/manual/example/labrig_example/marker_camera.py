"""A camera that draws a marker: a bright disc that drifts to the right with rig time."""

from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field

from labrig.clock import Clock
from labrig.devices.camera import CameraContext, CameraDescription, Exposure, RigKind, Setting

_BACKGROUND, _DISC = 30, 220


class MarkerDescription(CameraDescription):
    """The section `camera` of a rig file with `driver: example-marker`."""

    rig_kinds: ClassVar[frozenset[RigKind]] = frozenset({"simulated", "bench"})

    driver: Literal["example-marker"] = Field(description="example-marker: a drawn disc.")
    radius_px: Annotated[float, Field(ge=2, le=100)] = Field(8.0, description="Radius of the disc [px].")
    drift_px_s: Annotated[float, Field(ge=-10, le=10)] = Field(
        0.0, description="How fast the disc drifts to the right [px/s]."
    )

    def open(self, context: CameraContext) -> "MarkerSource":
        """Open the camera."""
        return MarkerSource(self, context.clock)


class MarkerSource:
    """Draws the disc; a real camera would open its device here."""

    def __init__(self, section: MarkerDescription, clock: Clock) -> None:
        self._section = section
        self._clock = clock
        self._settings: dict[str, Setting] = {}

    def set(self, name: str, value: Setting) -> None:
        """Set a value."""
        self._settings[name] = value

    def get(self, name: str) -> Setting | None:
        """Return the value in use."""
        return self._settings.get(name)

    def read(self) -> Exposure:
        """Draw a picture."""
        section = self._section
        v_px, u_px = np.mgrid[: section.height_px, : section.width_px]
        centre_u_px = section.width_px / 2 + section.drift_px_s * self._clock.now_s()
        distance_px = np.hypot(u_px - centre_u_px, v_px - section.height_px / 2)
        share = np.clip(section.radius_px + 0.5 - distance_px, 0, 1)
        return Exposure((_BACKGROUND + (_DISC - _BACKGROUND) * share).astype(np.uint8))

    def close(self) -> None:
        """Do nothing: nothing is open."""


CAMERA = MarkerDescription
"""What the entry point names."""
