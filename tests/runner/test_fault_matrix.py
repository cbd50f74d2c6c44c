"""The fault matrix: every fault in every phase ends as the table states."""

from pathlib import Path

import pytest

from tests.devices.fault_table import CELLS, FAULTS, SCENARIOS, Phase
from tests.runner.fault_cells import STRIKES, run_cell


def test_the_matrix_is_large_enough_and_has_no_blank() -> None:
    """The table has at least twenty faults in three phases, and each can be injected."""
    assert len(FAULTS) >= 20
    assert len(CELLS) == 3 * (len(FAULTS) + len(SCENARIOS))
    assert set(STRIKES) == {*FAULTS, *SCENARIOS}


@pytest.mark.parametrize(("fault", "phase"), CELLS, ids=[f"{f}-{p.value}" for f, p in CELLS])
def test_a_fault_ends_as_the_table_says(fault: str, phase: Phase, tmp_path: Path) -> None:
    """Ending, error, time to stand still in the drive's own journal, record, and what the next run believes."""
    assert run_cell(tmp_path, fault, phase).differences == ()
