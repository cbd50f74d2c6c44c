"""Measured constants: `tests/benchmarks/constants.json` has each with its origin and the commit that made it."""

import importlib
import json
from dataclasses import asdict, is_dataclass
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[1]
MEASURED: dict[str, Any] = json.loads((ROOT / "tests" / "benchmarks" / "constants.json").read_text())


@pytest.mark.parametrize("name", MEASURED)
def test_a_measured_constant_is_what_was_measured(name: str) -> None:
    """Whoever changes it measures it again, by the benchmark that is named, and says with which code."""
    module, _, constant = name.rpartition(".")
    found = getattr(importlib.import_module(module), constant)
    values = asdict(found()) if isinstance(found, type) and is_dataclass(found) else found
    assert json.loads(json.dumps(values)) == MEASURED[name]["values"]
    assert f'"{MEASURED[name]["by"]}": ' in (ROOT / "tests" / "benchmarks" / "__main__.py").read_text()
