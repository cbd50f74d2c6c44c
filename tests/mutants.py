"""Change a sample of places of steering, vision and record, one at a time, and count what the tests of the room notice.

Cosmic-ray finds the places and changes them, in a copy of the checkout.
"""

import argparse
import os
import random
import shlex
import shutil
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from difflib import unified_diff
from functools import cache
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

from cosmic_ray.ast import ast_nodes, get_ast_from_path
from cosmic_ray.mutating import use_mutation
from cosmic_ray.plugins import get_operator
from cosmic_ray.testing import run_tests
from coverage import CoverageData

ROOT = Path(__file__).parents[1]
LEAST_CAUGHT = 0.85
SWAPS = {
    "ComparisonOperator": "Lt_LtE Lt_Gt LtE_Lt LtE_Gt Gt_GtE Gt_Lt GtE_Gt GtE_Lt Eq_NotEq NotEq_Eq Is_IsNot IsNot_Is",
    "BinaryOperator": "Add_Sub Sub_Add Mul_Div Div_Mul Pow_Mul BitAnd_BitOr",
    "UnaryOperator": "USub_UAdd Delete_Not",
}
OTHERS = """AddNot ExceptionReplacer NumberReplacer ReplaceAndWithOr ReplaceBreakWithContinue ReplaceContinueWithBreak
    ReplaceFalseWithTrue ReplaceOrWithAnd ReplaceTrueWithFalse ZeroIterationForLoop"""
OPERATORS = {
    name: get_operator(f"core/{name}")()
    for name in [f"Replace{kind}_{swap}" for kind in SWAPS for swap in SWAPS[kind].split()] + OTHERS.split()
}
"""Of cosmic-ray's: not those that every test would notice, such as `<<` for the `+` of two floats."""


def main() -> int:
    """Print each change and whether a test noticed it, and the share that was noticed; 1 if that is too small."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sample", type=int, default=200, help="how many changes; of each room as many")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--rooms", nargs="+", default=["steering", "vision", "record"])
    asked = parser.parse_args()
    print(f"seed {asked.seed}", flush=True)
    ends = Counter[str]()
    with tempfile.TemporaryDirectory() as folder:
        ignored = shutil.ignore_patterns(".venv", ".git", ".hypothesis", ".*_cache")
        os.chdir(shutil.copytree(ROOT, Path(folder, "labrig"), ignore=ignored))
        os.environ["PYTHONPATH"] = str(Path.cwd())
        for number, room in enumerate(asked.rooms):
            places = [
                place for file in sorted(Path("labrig", room).rglob("*.py")) for place in _find_places(file)
            ]
            count = (asked.sample + number) // len(asked.rooms)
            times_s, limit_s = _time_tests(room)
            for file, name, occurrence in sorted(random.Random(asked.seed).sample(places, count)):
                tests = _find_tests(file, name, occurrence, times_s)
                with use_mutation(file, OPERATORS[name], occurrence) as codes:
                    end = _try_tests(tests, limit_s)
                ends[end] += 1
                before, after = (code.split("\n") for code in codes)
                change = list(unified_diff(before, after, n=0, lineterm=""))[2:]
                print(f"{end}: {file}", *change, sep="\n    ", flush=True)
    caught = 1.0 - ends["survived"] / ends.total()
    print(f"{caught:.1%} of {ends.total()} caught, seed {asked.seed}: {dict(ends)}")
    return int(caught < LEAST_CAUGHT)


def _find_places(file: Path) -> list[tuple[Path, str, int]]:
    """Return file, operator and number of each place, without those of decorators, such as frozen=True."""
    lines = file.read_text(encoding="utf-8").split("\n")
    return [
        (file, name, number)
        for name in OPERATORS
        for number, line in enumerate(_find_lines(file, name))
        if not lines[line - 1].startswith("@")
    ]


def _find_lines(file: Path, name: str) -> Iterator[int]:
    """Yield the lines of the places that an operator changes."""
    for node in _parse(file):
        for start, _ in OPERATORS[name].mutation_positions(node):
            yield start[0]


@cache
def _parse(file: Path) -> list[Any]:
    return list(ast_nodes(get_ast_from_path(file)))


def _time_tests(room: str) -> tuple[dict[str, float], float]:
    """Return how long each test of a room takes, and how long all may take, in s; keeps which lines each one runs."""
    start_s = time.monotonic()
    told = f"--junitxml=times.xml --cov=labrig/{room} --cov-context=test --cov-report= --cov-fail-under=0"
    if _try_tests([f"tests/{room}", *told.split()], 3600.0) != "survived":
        sys.exit(f"the tests of {room} fail before anything is changed")
    times_s = {
        f"{case.attrib['classname'].replace('.', '/')}.py::{case.attrib['name']}": float(case.attrib["time"])
        for case in ET.parse("times.xml").iter("testcase")
    }
    return times_s, 30.0 + 4.0 * (time.monotonic() - start_s)


def _find_tests(file: Path, name: str, occurrence: int, times_s: dict[str, float]) -> list[str]:
    """Return the tests that run a place, the quick ones first, then the files of tests that import its module.

    What is run on import, such as a constant, may show in every test. What a function keeps in a cache shows in others
    than the one that ran it: those import the module.
    """
    line = list(_find_lines(file, name))[occurrence]
    data = CoverageData()
    data.read()
    contexts = data.contexts_by_lineno(str(file.resolve())).get(line, [])
    run = {context.partition("|")[0] for context in contexts} & times_s.keys()
    tests = sorted(run or times_s, key=times_s.__getitem__)
    files = sorted({test.partition("::")[0] for test in times_s})
    imported = f"{file.parts[1]}.{file.stem} import"
    return [*tests, *(path for path in files if run and imported in Path(path).read_text(encoding="utf-8"))]


def _try_tests(tests: list[str], limit_s: float) -> str:
    end, told = run_tests(
        shlex.join([sys.executable, "-m", "pytest", "-x", "-q", "-m", "not slow", *tests]), limit_s
    )
    return "timeout" if told == "timeout" else "survived" if end == "survived" else "caught"


if __name__ == "__main__":
    sys.exit(main())
