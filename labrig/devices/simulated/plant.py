"""The simulated rig: drives on a bus, their shafts coupled to the world, all in one simulated time."""

from labrig.devices.bus import CanLink
from labrig.devices.camera import PictureSource
from labrig.devices.clocks import SimulatedClock
from labrig.devices.rig_file import RigDescription, require_complete
from labrig.devices.simulated.bus import InProcessWire, attach
from labrig.devices.simulated.camera import SimulatedSource
from labrig.devices.simulated.drive import SimulatedDrive
from labrig.devices.simulated.operator import SimulatedOperator
from labrig.simulation import World, WorldDescription


class SimulatedPlant:
    """What stands where a bench has its hardware.

    Parameters
    ----------
    rig : RigDescription
        The rig file.
    world : WorldDescription
        Its world.
    seed : int
        For every draw of the world.

    Raises
    ------
    InputError
        When the rig file has unknown entries.
    """

    def __init__(self, rig: RigDescription, world: WorldDescription, seed: int) -> None:
        require_complete(rig)
        self.clock = SimulatedClock()
        self.world = World(world, seed)
        self.operator = SimulatedOperator(self.world)
        self.wire = InProcessWire()
        self._scales = {name: axis.scale() for name, axis in rig.axes.items()}
        self.drives = {
            name: SimulatedDrive(
                self.wire,
                axis.node_id,
                self.clock,
                encoder_pulses=self._scales[name].encoder_pulses_per_turn,
            )
            for name, axis in rig.axes.items()
        }
        self._positions = (0.0, 0.0, 0.0)
        for drive in self.drives.values():
            self.clock.on_advance(drive.tick)
        self.clock.on_advance(self._move_world)

    def open_link(self) -> CanLink:
        """Return a link to the bus inside the process."""
        return attach(self.wire)

    def open_source(self) -> PictureSource:
        """Return a camera that sees the world."""
        return SimulatedSource(self.world)

    def truth(self) -> tuple[dict[str, object], ...]:
        """Return what is true of the present insertion."""
        return (self.world.truth(),)

    def close(self) -> None:
        """Take the drives off the bus."""
        for drive in self.drives.values():
            drive.unplug()

    def _move_world(self) -> None:
        """Take the world to where the shafts stand; all of them stand at zero when the rig is new."""
        insertion, rotation, linear = (
            self._scales[name].to_position(drive.shaft_quadcounts) for name, drive in self.drives.items()
        )
        if (insertion, rotation, linear) != self._positions:
            self._positions = (insertion, rotation, linear)
            self.world.advance(insertion, rotation, linear)
