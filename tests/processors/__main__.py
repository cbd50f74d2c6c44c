"""Run tests and probes in each environment, print the largest differences from the default one, and judge them.

The exit code is 1 if a test fails, a number differs by more than `_MOST_SHARE` of its sigma, more cases than
`_MOST_OTHERWISE` of all are decided otherwise, or an example protocol does not replay identically where it was made.
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import starmap
from pathlib import Path
from typing import Any

from labrig.analysis.engine import CORES
from labrig.record.provenance import describe_change
from tests.benchmarks.table import print_rows
from tests.processors.environments import DEFAULT, Environment, list_environments
from tests.processors.probes import EXAMPLE, EXAMPLES, REPLAYED

_MOST_SHARE = 0.01
_MOST_OTHERWISE = 0.02
_TESTS = Path(__file__).parents[1]


@dataclass(frozen=True)
class Made:
    """What was made in an environment: kernels, cases by name, what pytest said of failures, and the time it took."""

    processor: Mapping[str, str]
    cases: Mapping[str, Mapping[str, Any]]
    failures: Sequence[str]
    tests: str
    took_s: float


@dataclass(frozen=True)
class Difference:
    """The largest differences of a quantity: absolute, and as a share of the sigma beside it."""

    absolute: float
    share: float

    def __str__(self) -> str:
        """Return both in a cell of the table."""
        return "0" if self.absolute == 0.0 else f"{self.absolute:.0e} ({self.share:.0e})"


@dataclass(frozen=True)
class Comparison:
    """The largest difference of each quantity, and how many of the cases were decided otherwise, with their words."""

    largest: Mapping[str, Difference]
    cases: int
    otherwise: Sequence[str]

    @property
    def is_equivalent(self) -> bool:
        """Whether decisions and numbers agree as they must."""
        agree = all(each.share <= _MOST_SHARE for each in self.largest.values())
        return agree and len(self.otherwise) <= _MOST_OTHERWISE * self.cases


def main() -> int:
    """Run everything, print it, and return the exit code."""
    environments = list_environments()
    with tempfile.TemporaryDirectory() as name, ThreadPoolExecutor(CORES) as pool:
        folder = Path(name)
        examples = folder / "examples"
        _require(_run(environments[0], "tests.processors.examples", str(examples)), "recording examples")
        os.environ[EXAMPLES] = str(examples)
        made = list(pool.map(lambda each: _make(each, folder), environments))
    default, *others = made
    for environment, here in zip(environments, made, strict=True):
        _print_environment(environment, here, default)
    compared = {
        environment.name: _compare(default.cases, here.cases)
        for environment, here in zip(environments[1:], others, strict=True)
    }
    _print_table(compared)
    passed = not any(here.failures for here in made)
    return 0 if passed and all(each.is_equivalent for each in compared.values()) else 1


def _make(environment: Environment, folder: Path) -> Made:
    began_s = time.perf_counter()
    out = folder / f"{environment.name}.json"
    _require(
        _run(environment, "tests.processors.probes", str(out)),
        f"probes in the environment {environment.name}",
    )
    found = json.loads(out.read_text(encoding="utf-8"))
    cases = {case["name"]: case for case in found["cases"]}
    failures, ends = _test(environment)
    if environment.name == DEFAULT:
        failures += _find_not_identical(cases)
    return Made(found["processor"], cases, failures, ends, time.perf_counter() - began_s)


def _require(done: "subprocess.CompletedProcess[str]", what: str) -> None:
    if done.returncode != 0:
        raise RuntimeError(f"{what} failed:\n{done.stderr}")


def _test(environment: Environment) -> tuple[list[str], str]:
    """Run the tests that are marked; return the lines of failures, and what pytest says at its end."""
    marked = [str(path) for path in sorted(_TESTS.rglob("test_*.py")) if _has_marked(path)]
    done = _run(environment, "pytest", "-q", "-p", "no:cacheprovider", "-m", "processors", *marked)
    lines = done.stdout.splitlines()
    failures = [line for line in lines if line.startswith(("FAILED", "ERROR"))]
    return failures or (lines[-20:] if done.returncode else []), lines[-1]


def _find_not_identical(cases: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """Return the example protocols that do not replay identically, here where they were made."""
    return [
        f"{name}: not identical"
        for name, case in cases.items()
        if name.startswith(EXAMPLE)
        and (case["decided"] != "agrees" or any(value for value, _ in case["numbers"][REPLAYED]))
    ]


def _has_marked(path: Path) -> bool:
    return "@pytest.mark.processors" in path.read_text(encoding="utf-8")


def _run(environment: Environment, module: str, *words: str) -> "subprocess.CompletedProcess[str]":
    return subprocess.run(
        [sys.executable, "-m", module, *words],
        cwd=_TESTS.parent, env={**os.environ, **environment.variables}, capture_output=True, text=True, check=False,
    )  # fmt: skip


def _print_environment(environment: Environment, here: Made, default: Made) -> None:
    change = describe_change(default.processor, here.processor)
    kernels = "as chosen" if here is default else change or "nothing changes on this computer"
    print(f"{environment.name}: {kernels}\n  {here.took_s:.0f} s; {here.tests}")
    for line in here.failures:
        print(f"  {line}")


def _compare(default: Mapping[str, Any], here: Mapping[str, Any]) -> Comparison:
    largest: dict[str, Difference] = {}
    otherwise = []
    for name, ours in default.items():
        theirs = here[name]
        if ours["decided"] != theirs["decided"]:
            otherwise.append(f"{name}: {_tell_apart(ours['decided'], theirs['decided'])}")
            continue
        for quantity, values in ours["numbers"].items():
            both = zip(values, theirs["numbers"][quantity], strict=True)
            differences = list(starmap(_differ, both))
            known = largest.get(quantity, Difference(0.0, 0.0))
            largest[quantity] = Difference(
                max(known.absolute, *(each.absolute for each in differences)),
                max(known.share, *(each.share for each in differences)),
            )
    return Comparison(largest, len(default), otherwise)


def _differ(ours: tuple[float, float], theirs: tuple[float, float]) -> Difference:
    (value, sigma), (other, _) = ours, theirs
    return Difference(abs(other - value), abs(other - value) / sigma)


def _tell_apart(ours: str, theirs: str) -> str:
    """Return what differs of two texts, with some words before it."""
    same = next((at for at, (a, b) in enumerate(zip(ours, theirs, strict=False)) if a != b), 0)
    begin = max(0, same - 30)
    return f"...{ours[begin : same + 40]}... is here ...{theirs[begin : same + 40]}..."


def _print_table(compared: Mapping[str, Comparison]) -> None:
    print("\nLargest difference from the default environment, and in brackets the largest in units of sigma")
    quantities = dict.fromkeys(name for each in compared.values() for name in each.largest)
    rows = [(name, *(each.largest.get(name, "-") for each in compared.values())) for name in quantities]
    decided = ("decided otherwise", *(f"{len(each.otherwise)} of {each.cases}" for each in compared.values()))
    print_rows(("quantity", *compared), [*rows, decided])
    for line in _list_otherwise(compared):
        print(line)


def _list_otherwise(compared: Mapping[str, Comparison]) -> Iterator[str]:
    for name, each in compared.items():
        for told in each.otherwise:
            yield f"{name}: {told}"


if __name__ == "__main__":
    sys.exit(main())
