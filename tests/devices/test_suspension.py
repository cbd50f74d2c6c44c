"""A computer that is suspended while axes move: the drives stop, and labrig says why."""

import re
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest

from labrig.devices.clocks import SimulatedClock, SystemClock
from labrig.devices.rig import Rig
from labrig.devices.simulated.hardware import SimulatedHardware
from labrig.errors import DriveFaultError, MachineError, SafetyStopError
from tests.devices.rigs import OpenedRig, Person, Signal, simulated_rig


class SuspendedClock(SimulatedClock):
    """Rig time of a computer that can be suspended; time passes for the drives all the same."""

    def __init__(self, drives: SimulatedClock) -> None:
        super().__init__()
        self._drives = drives
        self._suspended_s = 0.0

    def sleep(self, duration_s: float) -> None:
        """Let rig time pass, and that of the drives."""
        self._drives.sleep(duration_s)
        super().sleep(duration_s)

    def suspend(self, duration_s: float) -> None:
        """Let time pass for the drives alone."""
        self._drives.sleep(duration_s)
        self._suspended_s += duration_s

    def suspended_s(self) -> float:
        """Return what rig time has left out."""
        return self._suspended_s


class Laptop(SimulatedHardware):
    """A simulated rig whose drives have a clock of their own."""

    def __init__(self) -> None:
        description = simulated_rig()
        assert description.world is not None
        super().__init__(description, description.world, seed=1)
        self.clock = self.laptop = SuspendedClock(self.clock)


@contextmanager
def moving() -> Iterator[tuple[OpenedRig, Laptop]]:
    """Open a rig, with its needle on the way."""
    laptop, signal, person = Laptop(), Signal(), Person()
    link = laptop.open_link()
    rig = Rig(simulated_rig(), hardware=laptop, link=link, source=None, person=person, interrupted=signal)
    rig.connect()
    rig.reference_axes()
    rig.insertion.start_move(40.0, 5.0)
    rig.wait(1.0)
    yield OpenedRig(rig, laptop, signal, person), laptop
    link.close()
    laptop.close()


def _wait(rig: Rig) -> None:
    rig.wait(1.0)


def _read(rig: Rig) -> None:
    rig.read_states()


@pytest.mark.parametrize(
    ("resume", "error"), [(_wait, SafetyStopError), (_read, DriveFaultError)], ids=["waits", "reads"]
)
def test_a_suspended_computer_says_so_at_once(
    resume: Callable[[Rig], None], error: type[MachineError]
) -> None:
    """Whatever it does first when it goes on, it blames neither wiring nor drives."""
    with moving() as (opened, laptop):
        laptop.laptop.suspend(300.0)
        with pytest.raises(
            error, match="the computer was suspended for 300 s, so the drives stopped by"
        ) as said:
            resume(opened.rig)
        assert "keep the computer awake" in said.value.hint
        assert not re.search("wiring|power the drive", said.value.hint)
        assert laptop.laptop.now_s() < 5.0


def test_a_suspension_that_the_drives_did_not_notice_ends_nothing() -> None:
    """The needle arrives."""
    with moving() as (opened, laptop):
        laptop.laptop.suspend(0.1)
        opened.rig.wait(0.5)
        assert opened.rig.read_states()["insertion"].position > 5.0


@pytest.mark.skipif(not hasattr(time, "CLOCK_BOOTTIME"), reason="only Linux tells")
def test_a_computer_that_stays_awake_is_not_suspended() -> None:
    """The two clocks of the kernel go alike."""
    assert SystemClock().suspended_s() < 0.1
