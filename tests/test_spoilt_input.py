"""A short run of the fuzzer; `python -m tests.benchmarks fuzz` is the long one."""

from pathlib import Path

import pytest

from tests.benchmarks.fuzz import Kind, list_kinds, run_case

pytestmark = pytest.mark.slow

_CASES = 6


@pytest.mark.parametrize("kind", list_kinds(), ids=lambda kind: kind.name)
def test_spoilt_input_ends_with_a_documented_exit_code(kind: Kind, tmp_path: Path) -> None:
    """Neither a traceback nor a hang, whatever was spoilt; the same files and options every time."""
    outcomes = [run_case(kind, number, tmp_path) for number in range(_CASES)]
    assert [outcome.fault for outcome in outcomes if outcome.fault] == []
