"""The section of an axis with a CiA 402 drive, which has the one driver, its check and its simulation."""

from collections.abc import Iterator

from labrig.clock import Clock
from labrig.devices.bus import CanLink
from labrig.devices.check_result import CheckResult
from labrig.devices.drives import objects as co
from labrig.devices.drives.check import check_axis
from labrig.devices.drives.cia402 import Cia402Drive
from labrig.devices.drives.eds import find_bounds, read_own_eds
from labrig.devices.drives.model import Cia402Section
from labrig.devices.drives.objects import Place
from labrig.devices.simulated.bus import InProcessWire
from labrig.devices.simulated.cia402 import SimulatedCia402Drive
from labrig.devices.simulated.kinds import Behaviour, be_cia402
from labrig.devices.simulated.shaft import Mechanics
from labrig.errors import InputError
from labrig.protocol.model import Conflict

_WITHOUT_IT = "labrig needs it: use the EDS file of this drive, name another object, or use another drive"


class ProductSection(Cia402Section):
    """The section of a product: it derives from this, and returns a `Model`."""

    def open(self, link: CanLink, axis: str, clock: Clock) -> Cia402Drive:
        """Return the drive of the axis of this name."""
        return Cia402Drive(link, self, axis, clock)

    def check(self, link: CanLink, axis: str, clock: Clock) -> Iterator[CheckResult]:
        """Compare the axis with its drive; nothing is written."""
        return check_axis(link, self, axis, clock)

    def problems(self) -> Iterator[Conflict]:
        """Yield an EDS file that cannot be used for this section, and values that the drive does not take."""
        settings = dict[Place, int]()
        try:
            model = self.model()
            if not self.unknown:
                settings = {**model.list_settings(self), **model.stop_options}
                model.list_homing_settings(self, self.homing)
        except InputError as error:
            yield Conflict("driver", error.message, error.hint)
            return
        names = {place: f" ({found.name})" for place, found in read_own_eds("cia402.eds").objects.items()}
        for place in (*names, *model.needs):
            if not model.has(place):
                lacking = f"{model.eds.source} has no object {place}{names.get(place, '')}"
                yield Conflict("driver", lacking, _WITHOUT_IT)
        ends = ((co.TARGET_POSITION, self.scale().to_counts(limit)) for limit in self.limits if settings)
        for place, value in (*settings.items(), *ends):
            low, high = find_bounds(model.eds.objects[place]) if model.takes(place) else (value, value)
            if not low <= value <= high:
                yield Conflict(
                    "driver",
                    f"{model.eds.objects[place].name} ({place}) would be {value}, the drive takes {low} to {high}",
                    "check limits, speeds, accelerations, windows and units of this axis",
                )

    def simulate(
        self, wire: InProcessWire, clock: Clock, mechanics: Mechanics, boot_time_s: float = 0.0
    ) -> SimulatedCia402Drive:
        """Return a simulated drive on a wire, which behaves as the product does."""
        return SimulatedCia402Drive(
            self, wire, clock, mechanics, self.find_behaviour(), boot_time_s=boot_time_s
        )

    def find_behaviour(self) -> Behaviour:
        """Return how the product behaves; by default as any CiA 402 drive with its EDS file."""
        return be_cia402(self)
