"""The drives of a rig file, simulated with the mechanics of its axes."""

from dataclasses import replace
from typing import Protocol

from labrig.clock import Clock
from labrig.devices.axis_description import AxisDescription
from labrig.devices.rig_file import RigDescription, require_complete
from labrig.devices.simulated.bus import InProcessWire
from labrig.devices.simulated.motor import Motor, torque_of_force
from labrig.devices.simulated.shaft import Mechanics
from labrig.devices.units import AxisScale

_STOP_BEYOND, _SWITCH_BEYOND = 2.0, 1.0
"""Distance of the hard stops and limit switches beyond the limits of a travelling axis [mm]."""


class AxisForces(Protocol):
    """What resists the axes: the world, which has needle and sheath in it."""

    def insertion_force_n(self) -> float:
        """Return the force that resists the insertion axis now [N]."""

    def linear_force_n(self) -> float:
        """Return the force that resists the linear axis now [N]."""

    def force_sensor_mv(self) -> float:
        """Return the voltage of the load cell at the needle [mV]."""


class SimulatedPlant:
    """Simulated drives on a wire, by their axes; in a new plant every axis stands at zero.

    Digital inputs that a run expects on are on: a door is closed.

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
    forces : AxisForces or None
        What resists the axes; the load cell is wired to analog-1 of the insertion drive. None: friction alone.

    Raises
    ------
    InputError
        When entries of the rig file are unknown, or a drive cannot be simulated.
    """

    def __init__(
        self,
        rig: RigDescription,
        wire: InProcessWire,
        clock: Clock,
        *,
        boot_time_s: float = 0.0,
        forces: AxisForces | None = None,
    ) -> None:
        require_complete(rig, dict(rig.axes.items()))
        self._scales = {name: axis.scale() for name, axis in rig.axes.items()}
        self.drives = {
            name: axis.simulate(wire, clock, self._load(name, axis, forces), boot_time_s)
            for name, axis in rig.axes.items()
        }
        for name, axis in rig.axes.items():
            for channel in axis.inputs.values():
                if channel.expected:
                    self.drives[name].set_input(channel.source, 1.0)

    def _load(self, name: str, axis: AxisDescription, forces: AxisForces | None) -> Mechanics:
        """Return the stops of an axis, with what resists it."""
        stops = _make_stops(axis, self._scales[name])
        if forces is None or axis.lead_mm is None:
            return stops
        resists = {"insertion": forces.insertion_force_n, "linear": forces.linear_force_n}[name]
        turn_mm, gear_ratio = axis.lead_mm, axis.gear_ratio or 1.0
        motor = Motor(load_mnm=lambda: torque_of_force(resists(), turn_mm, gear_ratio))
        wired = {"analog-1": forces.force_sensor_mv} if name == "insertion" else {}
        return replace(stops, motor=motor, analog_mv=wired)

    def true_positions(self) -> dict[str, float]:
        """Return the true position of each axis [mm or rad]."""
        return {
            name: self._scales[name].to_position(drive.shaft_counts) for name, drive in self.drives.items()
        }

    def close(self) -> None:
        """Take the drives off the bus."""
        for drive in self.drives.values():
            drive.unplug()


def _make_stops(axis: AxisDescription, scale: AxisScale) -> Mechanics:
    """Return the stops and switches of an axis, whose shaft is at zero in a new rig; none for a rotating axis."""
    if axis.unit == "rad":
        return Mechanics()
    low, high = axis.limits

    def shaft(*positions: float) -> list[float]:
        return sorted(float(scale.to_counts(position)) for position in positions)

    lower_stop, upper_stop = shaft(low - _STOP_BEYOND, high + _STOP_BEYOND)
    negative, positive = shaft(low - _SWITCH_BEYOND, high + _SWITCH_BEYOND)
    return Mechanics(lower_stop, upper_stop, negative, positive)
