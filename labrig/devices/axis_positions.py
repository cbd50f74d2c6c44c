"""Positions of the three axes at one instant."""

from collections.abc import Mapping
from dataclasses import astuple, dataclass

from labrig.devices.drives.drive import DriveReading


@dataclass(frozen=True)
class AxisPositions:
    """Positions of the three axes."""

    insertion_mm: float
    rotation_rad: float
    linear_mm: float

    def interpolate_to(self, other: "AxisPositions", fraction: float) -> "AxisPositions":
        """Return the positions at a fraction, 0 to 1, of the way to another set of positions."""
        ends = zip(astuple(self), astuple(other), strict=True)
        return AxisPositions(*((1.0 - fraction) * start + fraction * end for start, end in ends))


def collect_axis_positions(states: Mapping[str, DriveReading]) -> AxisPositions:
    """Return the positions in the states that `Rig.read_states` returns."""
    return AxisPositions(states["insertion"].position, states["rotation"].position, states["linear"].position)
