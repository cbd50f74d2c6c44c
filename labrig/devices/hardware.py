"""What a rig is made of, real or simulated, as one `Hardware`; here, and only here, the rig file chooses."""

from collections.abc import Sequence
from typing import Protocol

from labrig.clock import Clock
from labrig.devices.bus import CanLink, open_can
from labrig.devices.camera import PictureSource
from labrig.devices.camera_kind import CameraContext, find_camera_kind
from labrig.devices.clocks import SystemClock
from labrig.devices.operator import Operator
from labrig.devices.past_insertion import PastInsertion
from labrig.devices.rig_file import RigDescription
from labrig.devices.simulated.hardware import SimulatedHardware


class Hardware(Protocol):
    """Where bus, camera and clock of a rig come from."""

    @property
    def clock(self) -> Clock:
        """The clock in which everything of this rig happens."""

    @property
    def operator(self) -> Operator | None:
        """Whoever answers by itself; None where a person has to."""

    def open_link(self) -> CanLink:
        """Connect to the bus. Raises `BusError`."""

    def open_source(self) -> PictureSource:
        """Open the camera. Raises `CameraError`."""

    def truth(self) -> tuple[dict[str, object], ...]:
        """Return what is true of the present insertion, as far as anybody knows."""

    def recall(self, insertions: Sequence[PastInsertion]) -> None:
        """Take note of what was done before in the specimens that stand by; a world that is new knows nothing of it."""

    def close(self) -> None:
        """Let go of what neither link nor source holds."""


class BenchHardware:
    """A real bus, camera and clock.

    Parameters
    ----------
    rig : RigDescription
        Says which.
    """

    operator: Operator | None = None

    def __init__(self, rig: RigDescription) -> None:
        self.clock = SystemClock()
        self._rig = rig

    def open_link(self) -> CanLink:
        """Connect to the CAN interface. Raises `BusError`."""
        return open_can(self._rig.can, self.clock)

    def open_source(self) -> PictureSource:
        """Open the camera. Raises `CameraError`."""
        context = CameraContext(self.clock, self._rig.folder)
        return find_camera_kind(self._rig.camera.driver).open(self._rig.camera, context)

    def truth(self) -> tuple[dict[str, object], ...]:
        """Return nothing: nobody knows."""
        return ()

    def recall(self, insertions: Sequence[PastInsertion]) -> None:
        """Do nothing: real gels remember by themselves."""

    def close(self) -> None:
        """Nothing is held beside link and source."""


def make_hardware(rig: RigDescription, seed: int) -> Hardware:
    """Return what the rig file describes; nothing is opened yet.

    Parameters
    ----------
    rig : RigDescription
        The rig file.
    seed : int
        For every draw of a simulated world.

    Raises
    ------
    InputError
        When entries are unknown that a simulated rig needs.
    """
    return BenchHardware(rig) if rig.world is None else SimulatedHardware(rig, rig.world, seed)
