"""Where the three axes stand, at one instant."""

from collections.abc import Mapping
from dataclasses import dataclass

from labrig.devices import AxisReadback


@dataclass(frozen=True)
class Stance:
    """Where the three axes stand."""

    insertion_mm: float
    rotation_rad: float
    linear_mm: float

    def halfway_to(self, other: "Stance") -> "Stance":
        """Return the stance between this one and another."""
        return Stance(
            0.5 * (self.insertion_mm + other.insertion_mm),
            0.5 * (self.rotation_rad + other.rotation_rad),
            0.5 * (self.linear_mm + other.linear_mm),
        )


def stance_of(states: Mapping[str, AxisReadback]) -> Stance:
    """Return where the axes stand, as `Rig.read_states` gives it."""
    return Stance(states["insertion"].position, states["rotation"].position, states["linear"].position)
