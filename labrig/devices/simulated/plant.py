"""The drives of a rig file, simulated with the mechanics of its axes."""

from dataclasses import replace

from labrig.clock import Clock
from labrig.devices.axis_description import AxisDescription
from labrig.devices.rig_file import RigDescription, require_complete
from labrig.devices.simulated.bus import InProcessWire
from labrig.devices.simulated.motor import Motor, torque_of_force
from labrig.devices.simulated.shaft import Mechanics
from labrig.devices.simulated.simulated_node import SimulatedNode
from labrig.simulation.world import World

_STOP_BEYOND, _SWITCH_BEYOND = 2.0, 1.0
"""Distance of the hard stops and limit switches beyond the limits of a travelling axis [mm]."""


def make_drives(
    rig: RigDescription, wire: InProcessWire, clock: Clock, world: World
) -> dict[str, SimulatedNode]:
    """Return simulated drives on a wire, by their axes; every axis stands at zero.

    Digital inputs that a run expects on are on: a door is closed. The load cell is wired to analog-1 of the insertion
    drive.

    Raises
    ------
    InputError
        When entries of the rig file are unknown, or a drive cannot be simulated.
    """
    axes = dict(rig.axes.items())
    require_complete(rig, axes)
    drives = {
        name: axis.simulate(wire, clock, _make_mechanics(name, axis, world)) for name, axis in axes.items()
    }
    for name, axis in axes.items():
        for channel in axis.inputs.values():
            if channel.expected:
                drives[name].set_input(channel.source, 1.0)
    return drives


def _make_mechanics(name: str, axis: AxisDescription, world: World) -> Mechanics:
    """Return the stops of an axis, and what the world has against its motion."""
    if axis.unit == "rad" or axis.lead_mm is None:
        return Mechanics()
    resists = {"insertion": world.insertion_force_n, "linear": world.linear_force_n}[name]
    turn_mm, gear_ratio = axis.lead_mm, axis.gear_ratio or 1.0
    motor = Motor(load_mnm=lambda: torque_of_force(resists(), turn_mm, gear_ratio))
    wired = {"analog-1": world.force_sensor_mv} if name == "insertion" else {}
    return replace(_make_stops(axis), motor=motor, analog_mv=wired)


def _make_stops(axis: AxisDescription) -> Mechanics:
    """Return the stops and switches of a travelling axis, whose shaft is at zero in a new rig."""
    (low, high), scale = axis.limits, axis.scale()

    def shaft(*positions: float) -> list[float]:
        return sorted(float(scale.to_counts(position)) for position in positions)

    lower_stop, upper_stop = shaft(low - _STOP_BEYOND, high + _STOP_BEYOND)
    negative, positive = shaft(low - _SWITCH_BEYOND, high + _SWITCH_BEYOND)
    return Mechanics(lower_stop, upper_stop, negative, positive)
