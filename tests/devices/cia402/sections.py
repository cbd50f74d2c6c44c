"""Sections of axes with CiA 402 drives, and such drives on a bus."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from labrig.devices.bus import CanLink
from labrig.devices.can_description import HeartbeatDescription
from labrig.devices.clocks import SimulatedClock
from labrig.devices.drives.cia402 import Cia402Drive
from labrig.devices.drives.drive import Homing
from labrig.devices.drives.generic import DRIVE, Cia402Axis
from labrig.devices.simulated.bus import InProcessWire, attach
from labrig.devices.simulated.cia402 import SimulatedCia402Drive
from labrig.devices.simulated.shaft import Mechanics
from tests.devices.cia402.eds_text import HOME, RATED_CURRENT, WINDOW, eds_text

HEARTBEAT = HeartbeatDescription()
_OF_MAXON = (0x3000, 0x3001, 0x30B0, 0x30B1, 0x30D1, 0x603F, 0x60A8, 0x60A9, 0x60AA)


def section_of(folder: Path, text: str | None = None, **changes: object) -> Cia402Axis:
    """Return the example section with an EDS file of its own in `folder`, and with changes."""
    (folder / "drive.eds").write_text(eds_text() if text is None else text, encoding="ascii")
    values = DRIVE.example(1).model_dump() | {"eds": "drive.eds"} | changes
    return Cia402Axis.model_validate(values, strict=False).placed_in(folder)


def other_make(folder: Path) -> Cia402Axis:
    """Return the section of a drive of another make: the profile's own objects, and none of maxon's."""
    device = {"VendorNumber": "0x2F", "ProductName": "a drive of another make", "ProductNumber": 7}
    return section_of(
        folder,
        eds_text(*RATED_CURRENT, *HOME, *WINDOW, without=_OF_MAXON, device=device),
        velocity_unit="counts/s",
        acceleration_unit="counts/s^2",
        quick_stop_option=2,
        home_here_method=35,
        referenced_bit=None,
        objects={"home_position": "0x607C:00"},
    )


@dataclass
class ProfileDriveOnABus:
    """A driver, the simulated drive that it talks to, and their bus."""

    driver: Cia402Drive
    node: SimulatedCia402Drive
    clock: SimulatedClock
    link: CanLink

    def wait(self, duration_s: float) -> None:
        """Let time pass without the computer's heartbeat."""
        for _ in range(round(duration_s / 0.01)):
            self.clock.sleep(0.01)

    def home(self, homing: Homing) -> None:
        """Home to the end."""
        for _ in self.driver.home(homing):
            self.clock.sleep(0.01)

    def get_ready(self) -> None:
        """Configure and enable the drive."""
        self.driver.identify()
        self.driver.configure(HEARTBEAT, None)
        self.driver.enable()


@contextmanager
def drive_on_a_bus(
    section: Cia402Axis, node_section: Cia402Axis | None = None
) -> Iterator[ProfileDriveOnABus]:
    """Put a simulated drive on a bus, whose own section may be another than the driver's."""
    clock, wire = SimulatedClock(), InProcessWire()
    link = attach(wire, clock, 0.12)
    node = (node_section or section).simulate(wire, clock, Mechanics(-20_000.0, 20_000.0, -8_000.0, 8_000.0))
    clock.on_advance(node.tick)
    yield ProfileDriveOnABus(Cia402Drive(link, section, "rotation", clock), node, clock, link)
    link.close()
    node.unplug()
