"""How the tests run here.

Hypothesis makes the same examples every time, but for `make test-random`, and has no deadline, so that no test can fail
for timing. What was imported is never searched for garbage, which took a tenth of the time.
"""

import gc

import pytest
from hypothesis import settings

gc.disable()
settings.register_profile("labrig", deadline=None, derandomize=True, max_examples=60)
settings.register_profile("random", deadline=None, max_examples=20, print_blob=True)
settings.load_profile("labrig")


def pytest_collection_finish() -> None:
    """Search for garbage among what the tests make, and less often than Python does."""
    gc.freeze()
    gc.set_threshold(10_000, 20, 20)
    gc.enable()


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Say in one line what was not tried here, and why."""
    skipped = terminalreporter.getreports("skipped")
    told = {report.longrepr[2] for report in skipped if isinstance(report.longrepr, tuple | list)}
    if reasons := {str(reason).removeprefix("Skipped: ") for reason in told}:
        terminalreporter.write_line(f"{len(skipped)} tests were not tried here: {'; '.join(sorted(reasons))}")
