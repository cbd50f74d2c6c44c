"""The fault matrix: expected and actual outcome of each fault in each phase."""

import tempfile
from pathlib import Path

from tests.benchmarks.table import print_rows
from tests.devices.fault_table import CELLS, Stop, outcome_of
from tests.runner.fault_cells import run_cell


def print_table() -> None:
    """Run every cell; times come from the drives' own journals."""
    rows, wrong = [], 0
    for fault, phase in CELLS:
        expected = outcome_of(fault, phase)
        with tempfile.TemporaryDirectory() as folder:
            result = run_cell(Path(folder), fault, phase)
        wrong += bool(result.differences)
        error = "survived" if expected.error is None else expected.error.__name__
        limit = "-" if expected.stop is Stop.NO_DEADLINE else f"{1000 * expected.stop.value:.0f}"
        rows.append(
            [
                fault,
                phase.value,
                f"{expected.ends}, {error}",
                limit,
                f"{1000 * result.still_after_s:.0f}",
                "; ".join(result.differences) or "as expected",
            ]
        )
    print_rows(("fault", "axis", "expected", "limit ms", "still after ms", "outcome"), rows)
    print(f"{len(rows) - wrong} of {len(rows)} cells as expected")
