"""The drives that labrig brings pass the suite that a lab's own have to pass."""

from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest

from labrig.devices.axis_description import AxisDescription
from labrig.devices.simulated.hardware import SimulatedHardware
from labrig.errors import InputError
from labrig.testing.drives import DriveConformance, OpenedDrive, simulated_drive
from tests.devices.cia402.sections import other_make
from tests.devices.rigs import simulated_rig


class TestEpos2(DriveConformance):
    """An EPOS2 on a bus inside the process."""

    def open_drive(self) -> AbstractContextManager[OpenedDrive]:
        """Open it."""
        return simulated_drive("epos2")


def test_a_kind_without_a_simulated_drive_says_so() -> None:
    """A simulated rig refuses it by name."""
    rig = simulated_rig()
    plain = AxisDescription.model_construct(**{**dict(rig.axes.linear), "driver": "hydraulic"})
    rig = rig.model_copy(update={"axes": rig.axes.model_copy(update={"linear": plain})})
    assert rig.world is not None
    with pytest.raises(InputError, match="drives of kind hydraulic cannot be simulated"):
        SimulatedHardware(rig, rig.world, 1)


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
