"""The drives of a rig file, simulated with the mechanics of its axes."""

from labrig.clock import Clock
from labrig.devices.axis_description import AxisDescription
from labrig.devices.drive import find_drive_kind
from labrig.devices.rig_file import RigDescription, require_complete
from labrig.devices.simulated.bus import InProcessWire
from labrig.devices.simulated.shaft import Mechanics
from labrig.devices.units import AxisScale

_STOP_BEYOND, _SWITCH_BEYOND = 2.0, 1.0
"""Distance of the hard stops and limit switches beyond the limits of a travelling axis [mm]."""


class SimulatedPlant:
    """Simulated drives on a wire, by their axes; in a new plant every axis stands at zero.

    Parameters
    ----------
    rig : RigDescription
        The rig file.
    wire : InProcessWire
        The bus of the drives.
    clock : Clock
        Their time.
    boot_time_s : float
        Time that a drive takes from a reset to its boot-up frame [s].

    Raises
    ------
    InputError
        When entries of the rig file are unknown, or a drive cannot be simulated.
    """

    def __init__(
        self, rig: RigDescription, wire: InProcessWire, clock: Clock, *, boot_time_s: float = 0.0
    ) -> None:
        require_complete(rig, dict(rig.axes.items()))
        self._scales = {name: axis.scale() for name, axis in rig.axes.items()}
        self.drives = {
            name: find_drive_kind(axis.driver).simulate(
                axis, wire, clock, _make_mechanics(axis, self._scales[name]), boot_time_s
            )
            for name, axis in rig.axes.items()
        }

    def true_positions(self) -> dict[str, float]:
        """Return the true position of each axis [mm or rad]."""
        return {
            name: self._scales[name].to_position(drive.shaft_counts) for name, drive in self.drives.items()
        }

    def close(self) -> None:
        """Take the drives off the bus."""
        for drive in self.drives.values():
            drive.unplug()


def _make_mechanics(axis: AxisDescription, scale: AxisScale) -> Mechanics:
    """Return the stops and switches of an axis, whose shaft is at zero in a new rig; none for a rotating axis."""
    if axis.unit == "rad":
        return Mechanics()
    low, high = axis.limits

    def shaft(*positions: float) -> list[float]:
        return sorted(float(scale.to_counts(position)) for position in positions)

    lower_stop, upper_stop = shaft(low - _STOP_BEYOND, high + _STOP_BEYOND)
    negative, positive = shaft(low - _SWITCH_BEYOND, high + _SWITCH_BEYOND)
    return Mechanics(lower_stop, upper_stop, negative, positive)
