"""The fault matrix: every fault in every phase ends as the table states."""

from pathlib import Path

import pytest

from tests.devices.fault_table import CELLS, FAULTS, SCENARIOS, Phase
from tests.runner.fault_cells import STRIKES, cia402_rig, run_cell


def test_the_matrix_is_large_enough_and_has_no_blank() -> None:
    """The table has at least twenty faults in three phases, and each can be injected."""
    assert len(FAULTS) >= 20
    assert len(CELLS) == 3 * (len(FAULTS) + len(SCENARIOS))
    assert set(STRIKES) == {*FAULTS, *SCENARIOS}


@pytest.mark.parametrize(("fault", "phase"), CELLS, ids=[f"{f}-{p.value}" for f, p in CELLS])
def test_a_fault_ends_as_the_table_says(fault: str, phase: Phase, tmp_path: Path) -> None:
    """Ending, error, time to stand still in the drive's own journal, record, and what the next run believes."""
    assert run_cell(tmp_path, fault, phase).differences == ()


BY_CLASS = (
    "one answer lost",  # survived
    "node silent",  # it does not answer
    "boot-up",
    "SDO abort",
    "heartbeat of the drive lost",
    "EMCY over-current",  # power goes at once
    "EMCY CAN overrun",  # it brakes first
    "following error",
    "emergency stop",
    "bus off",
    "computer hangs",
    "second master resets",
    "encoder jumps",
    "stall in gel",
)
"""One fault of each class that does not depend on what an EPOS2 has of its own."""


@pytest.mark.parametrize("phase", [Phase.IDLE, Phase.MOVING])
@pytest.mark.parametrize("fault", BY_CLASS)
def test_a_fault_ends_alike_on_any_cia_402_drive(fault: str, phase: Phase, tmp_path: Path) -> None:
    """The drives have what their EDS file says, and the table is that of an EPOS2."""
    assert run_cell(tmp_path, fault, phase, cia402_rig).differences == ()
