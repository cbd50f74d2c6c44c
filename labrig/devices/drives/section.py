"""The section of an axis with a CiA 402 drive, which has the one driver, its check and its simulation."""

from collections.abc import Iterator

from labrig.clock import Clock
from labrig.devices.bus import CanLink
from labrig.devices.check_result import CheckResult
from labrig.devices.drives.check import check_axis
from labrig.devices.drives.cia402 import Cia402Drive
from labrig.devices.drives.model import Cia402Section
from labrig.devices.simulated.bus import InProcessWire
from labrig.devices.simulated.cia402 import SimulatedCia402Drive
from labrig.devices.simulated.kinds import Nature, be_cia402
from labrig.devices.simulated.shaft import Mechanics


class ProductSection(Cia402Section):
    """The section of a product: it derives from this, and returns a `Model`."""

    def open(self, link: CanLink, axis: str, clock: Clock) -> Cia402Drive:
        """Return the drive of the axis of this name."""
        return Cia402Drive(link, self, axis, clock)

    def check(self, link: CanLink, axis: str, clock: Clock) -> Iterator[CheckResult]:
        """Compare the axis with its drive; nothing is written."""
        return check_axis(link, self, axis, clock)

    def simulate(
        self, wire: InProcessWire, clock: Clock, mechanics: Mechanics, boot_time_s: float = 0.0
    ) -> SimulatedCia402Drive:
        """Return a simulated drive on a wire, of the nature of the product."""
        behaviour, fixed = self.find_nature()
        return SimulatedCia402Drive(
            self, wire, clock, mechanics, boot_time_s, behaviour=behaviour, fixed=fixed
        )

    def find_nature(self) -> Nature:
        """Return how the product behaves; by default as any CiA 402 drive with its EDS file."""
        return be_cia402(self)
