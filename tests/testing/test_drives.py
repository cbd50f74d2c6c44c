"""The drives that labrig brings pass the suite that a lab's own have to pass, on every bus."""

from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest

from labrig.devices.bus import open_can
from labrig.devices.can_description import CanDescription, HeartbeatDescription
from labrig.devices.clocks import SimulatedClock, SystemClock
from labrig.devices.drive import find_drive_kind
from labrig.devices.epos2 import DRIVE
from labrig.devices.simulated.bus import InProcessWire
from labrig.devices.simulated.shaft import Mechanics
from labrig.errors import InputError
from labrig.testing.drives import DriveConformance, OpenedDrive, simulated_drive
from tests.devices.cia402.sections import other_make
from tests.devices.rigs import epos2_axis
from tests.devices.served import served_drives

PATIENT = HeartbeatDescription(period_ms=100, timeout_ms=1000)


class TestEpos2(DriveConformance):
    """An EPOS2 on a bus inside the process."""

    def open_drive(self) -> AbstractContextManager[OpenedDrive]:
        """Open it."""
        return simulated_drive("epos2")


def test_a_kind_without_a_simulated_drive_says_so() -> None:
    """A simulated rig refuses it by name, as does what serves drives."""
    kind = replace(DRIVE, simulated_node=None, example=None)
    with pytest.raises(InputError, match="drives of kind epos2 cannot be simulated"):
        kind.simulate(epos2_axis(), InProcessWire(), SimulatedClock(), Mechanics())
    with pytest.raises(InputError, match="cannot be simulated"):
        kind.example_section(1)


@contextmanager
def _serve_drives(interface: str, driver: str = "epos2") -> Iterator[OpenedDrive]:
    section = find_drive_kind(driver).example_section(1)
    with served_drives(interface, section.nodes, driver) as served:
        reached_by = dict(served.reached_by)
        can = {key: reached_by.pop(key) for key in ("interface", "channel")}
        reached_by.pop("bitrate", None)
        clock = SystemClock()
        link = open_can(
            CanDescription.model_validate({**can, "options": reached_by, "answer_timeout_ms": 5000}), clock
        )
        yield OpenedDrive(link, section, clock, heartbeat=PATIENT)
        link.close()


class TestEpos2OverVirtual(DriveConformance):
    """An EPOS2 over python-can's virtual bus, in real time."""

    def open_drive(self) -> AbstractContextManager[OpenedDrive]:
        """Open it."""
        return _serve_drives("virtual")


class TestEpos2OverMulticast(DriveConformance):
    """An EPOS2 over udp_multicast, in real time."""

    def open_drive(self) -> AbstractContextManager[OpenedDrive]:
        """Open it."""
        return _serve_drives("udp_multicast")


class TestEpos2OverSlcan(DriveConformance):
    """An EPOS2 behind an slcan adapter, in real time."""

    def open_drive(self) -> AbstractContextManager[OpenedDrive]:
        """Open it."""
        return _serve_drives("slcan")


class TestCia402(DriveConformance):
    """An EPOS4, as any CiA 402 drive, on a bus inside the process."""

    def open_drive(self) -> AbstractContextManager[OpenedDrive]:
        """Open it."""
        return simulated_drive("cia402")


class TestCia402OverMulticast(DriveConformance):
    """The same over udp_multicast, in real time."""

    def open_drive(self) -> AbstractContextManager[OpenedDrive]:
        """Open it."""
        return _serve_drives("udp_multicast", "cia402")


class TestCia402OverSlcan(DriveConformance):
    """The same behind an slcan adapter, in real time."""

    def open_drive(self) -> AbstractContextManager[OpenedDrive]:
        """Open it."""
        return _serve_drives("slcan", "cia402")


class TestAnotherMake(DriveConformance):
    """A drive that takes counts a second, tells currents by the rated one, and whether it is referenced not at all."""

    @contextmanager
    def open_drive(self) -> Iterator[OpenedDrive]:
        """Open it."""
        with (
            TemporaryDirectory() as folder,
            simulated_drive("cia402", section=other_make(Path(folder))) as opened,
        ):
            yield opened
