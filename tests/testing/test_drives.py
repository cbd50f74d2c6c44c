"""The drives that labrig brings pass the suite that a lab's own have to pass."""

from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

from labrig.testing.drives import DriveConformance, OpenedDrive, simulated_drive
from tests.devices.eds_text import other_make


class TestEpos2(DriveConformance):
    """An EPOS2 on a bus inside the process."""

    def open_drive(self) -> AbstractContextManager[OpenedDrive]:
        """Open it."""
        return simulated_drive("epos2")


class TestCia402(DriveConformance):
    """An EPOS4, as any CiA 402 drive, on a bus inside the process."""

    def open_drive(self) -> AbstractContextManager[OpenedDrive]:
        """Open it."""
        return simulated_drive("cia402")


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
