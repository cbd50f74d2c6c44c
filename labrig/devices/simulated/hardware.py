"""The simulated rig: drives on a bus, with their shafts coupled to the world, all in one time.

The time is simulated, or real for a rehearsal. There is one thread for all of it, that which supervises: the drives and
the world see time pass whenever labrig sends a frame, takes a picture or waits.
"""

from labrig.clock import Clock
from labrig.devices.axis_description import AxisDescription
from labrig.devices.bus import CanLink
from labrig.devices.camera import CameraContext, PictureSource
from labrig.devices.clocks import SimulatedClock, WatchedClock
from labrig.devices.operator import Operator
from labrig.devices.rig_file import RigDescription, require_complete
from labrig.devices.simulated.bus import InProcessWire, attach
from labrig.devices.simulated.cia402 import SimulatedCia402Drive
from labrig.devices.simulated.faults import FaultScript
from labrig.devices.simulated.operator import RehearsedOperator, SimulatedOperator
from labrig.devices.simulated.shaft import Mechanics
from labrig.devices.worker import SAME_THREAD, Worker, WorkerThread
from labrig.simulation.description import WorldDescription
from labrig.simulation.world import World


class SimulatedHardware:
    """What takes the place of the hardware of a bench.

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
        When entries of the rig file are unknown.
    """

    def __init__(self, rig: RigDescription, world: WorldDescription, seed: int) -> None:
        self.clock = SimulatedClock() if rig.clock is None else WatchedClock()
        self.camera_worker: Worker = SAME_THREAD
        self.disk_worker = SAME_THREAD if rig.clock is None else WorkerThread("disk", self.clock)
        self._rig = rig
        self._answer_timeout_s = rig.can.answer_timeout_ms / 1000
        self.wire = InProcessWire()
        self.world = World(world, seed)
        self.drives = make_drives(rig, self.wire, self.clock)
        self._scales = {name: axis.scale() for name, axis in rig.axes.items()}
        self._hands = SimulatedOperator(self.world)
        self.operator = None if rig.asks_person else self._hands
        self._positions = dict.fromkeys(self.drives, 0.0)
        for drive in self.drives.values():
            self.clock.on_advance(drive.tick)
        self.faults = FaultScript(self.wire, self.drives, self.clock, rig.faults)
        self.clock.on_advance(self.faults.tick)
        self.clock.on_advance(self._move_world)
        if isinstance(self.clock, WatchedClock):
            self.wire.before_command = self.clock.tell
            self.world.picture()  # the first one takes a third of a second, later ones some milliseconds

    def accompany(self, person: Operator) -> Operator:
        """Return the person, whose hands the world follows."""
        return RehearsedOperator(person, self._hands)

    def open_link(self) -> CanLink:
        """Return a link to the bus inside the process."""
        return attach(self.wire, self.clock, self._answer_timeout_s)

    def open_source(self) -> PictureSource:
        """Open the camera, which may see the world. Raises `CameraError`."""
        return self._rig.camera.open(CameraContext(self.clock, self._rig.folder, self.world))

    def truth(self) -> tuple[dict[str, object], ...]:
        """Return what is true of the present insertion."""
        return (self.world.truth(),)

    def close(self) -> None:
        """Take the drives off the bus, once everything is on disk."""
        for drive in self.drives.values():
            drive.unplug()
        self.disk_worker.close()

    def _move_world(self) -> None:
        """Move the world to where the shafts are; in a new rig all of them are at zero."""
        where = {
            name: self._scales[name].to_position(drive.shaft_counts) for name, drive in self.drives.items()
        }
        if where != self._positions:
            self._positions = where
            self.world.advance(where["insertion"], where["rotation"], where["linear"])


_STOP_BEYOND, _SWITCH_BEYOND = 2.0, 1.0
"""Distance of the hard stops and limit switches beyond the limits of a travelling axis [mm]."""


def make_drives(rig: RigDescription, wire: InProcessWire, clock: Clock) -> dict[str, SimulatedCia402Drive]:
    """Return simulated drives on a wire, by their axes; every axis stands at zero.

    Digital inputs that a run expects on are on: a door is closed.

    Raises
    ------
    InputError
        When entries of the rig file are unknown.
    """
    require_complete(rig)
    drives = {}
    for name, axis in rig.axes.items():
        drives[name] = SimulatedCia402Drive(axis, wire, clock, _make_mechanics(axis))
        for channel in axis.inputs.values():
            if channel.expected:
                drives[name].set_input(channel.source, 1.0)
    return drives


def _make_mechanics(axis: AxisDescription) -> Mechanics:
    """Return the stops and switches of an axis, whose shaft is at zero in a new rig; one that turns has none."""
    if axis.unit == "rad":
        return Mechanics()
    (lower, upper), (negative, positive) = (
        sorted(
            float(axis.scale().to_counts(place))
            for place in (axis.limits[0] - beyond, axis.limits[1] + beyond)
        )
        for beyond in (_STOP_BEYOND, _SWITCH_BEYOND)
    )
    return Mechanics(lower, upper, negative, positive)
