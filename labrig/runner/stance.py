"""Where the three axes stand, at one instant."""

from collections.abc import Mapping
from dataclasses import dataclass

from labrig.devices.axis import AxisReadback


@dataclass(frozen=True)
class Stance:
    """Where the three axes stand."""

    insertion_mm: float
    rotation_rad: float
    linear_mm: float

    def on_the_way_to(self, other: "Stance", fraction: float) -> "Stance":
        """Return the stance at a fraction, 0 to 1, of the way from this one to another."""
        return Stance(
            (1.0 - fraction) * self.insertion_mm + fraction * other.insertion_mm,
            (1.0 - fraction) * self.rotation_rad + fraction * other.rotation_rad,
            (1.0 - fraction) * self.linear_mm + fraction * other.linear_mm,
        )


def stance_of(states: Mapping[str, AxisReadback]) -> Stance:
    """Return where the axes stand, as `Rig.read_states` gives it."""
    return Stance(states["insertion"].position, states["rotation"].position, states["linear"].position)
