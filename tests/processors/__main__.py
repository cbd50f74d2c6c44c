"""Run tests and probes in environments that make libraries take other kernels than those they choose here.

The exit code is 1 if a test fails, a record replays otherwise than it was made, a result is decided otherwise than in
the default environment, or a number of it differs by more than `_MOST_SHARE` of its tolerance. The examples, which were
made here, replay identically in the default environment.
"""

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pandas as pd

from labrig.analysis.divergence import compare_results
from labrig.analysis.engine import CORES
from labrig.record.agreement import Agreement
from labrig.record.provenance import describe_change, describe_processor
from tests.benchmarks.table import print_rows

DEFAULT = "default"
_MOST_SHARE = 0.1
"""Of a tolerance of `labrig.record.agreement`, which is a tenth of the standard deviation: 1 % of that."""
_LENS = ".intrinsics."
"""In the names of numbers without a standard deviation beside them: the whole of their relative tolerance counts."""
_MOST_SHOWN = 12
_TESTS = Path(__file__).parents[1]
# Sums do not depend on how they are shared among threads; OpenCV does not warn of what is switched off.
_ALWAYS = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "OPENCV_LOG_LEVEL": "ERROR"}


def list_environments() -> dict[str, Mapping[str, str]]:
    """Return environments by name, the default first; of features, they name this processor's, as numpy demands."""
    found = describe_processor()
    numpy = str(found["numpy"]).split()
    opencv = [name for name in str(found["opencv"]).split() if name.startswith("AVX512")]
    switches = {
        "BLAS": {"OPENBLAS_CORETYPE": "Nehalem"},
        "numpy": {"NPY_DISABLE_CPU_FEATURES": " ".join(numpy)},
        "OpenCV": {"OPENCV_CPU_DISABLE": ",".join(["AVX2", "FMA3", *opencv])},
        "IPP": {"OPENCV_IPP": "disabled"},
        # glibc calls its features so from 2.33 on, ..._Usable before; it passes over names that it does not know.
        "libm": {"GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-FMA,-AVX2_Usable,-FMA_Usable"},
    }
    environments: dict[str, Mapping[str, str]] = {DEFAULT: {}, **switches}
    if "avx512f" in str(found["features"]).split():  # what a processor with AVX2 alone would choose
        large = [name for name in numpy if name == "X86_V4" or name.startswith("AVX512")]
        environments["no AVX-512"] = {
            "OPENBLAS_CORETYPE": "Haswell", "NPY_DISABLE_CPU_FEATURES": " ".join(large),
            "OPENCV_CPU_DISABLE": ",".join(opencv), "OPENCV_IPP": "avx2",
        }  # fmt: skip
    environments["all at once"] = {name: value for each in switches.values() for name, value in each.items()}
    return environments


def main() -> int:
    """Run everything, print it, and return the exit code."""
    environments = list_environments()
    with tempfile.TemporaryDirectory() as name, ThreadPoolExecutor(CORES) as pool:
        examples = str(Path(name) / "examples")
        _require(_run({}, "tests.processors.probes", examples))
        found = list(
            pool.map(lambda each: _probe(environments[each], Path(name) / each, examples), environments)
        )
        tested = list(pool.map(_test, environments.values()))
    rows, failures, largest = [], [], dict[str, dict[str, float]]()
    for environment, here, (failed, ends) in zip(environments, found, tested, strict=True):
        kernels = describe_change(found[0]["processor"], here["processor"]) or "as chosen"
        wrong = [*failed, *_find_otherwise(environment, found[0], here)]
        rows.append((environment, len(wrong), ends, kernels))
        failures += [f"{environment}: {line}" for line in wrong]
        largest[environment] = _find_largest(found[0], here)
    print_rows(("environment", "wrong", "tests", "kernels"), rows)
    table = pd.DataFrame(largest).fillna(0.0)
    shown = table.loc[table.max(axis=1).nlargest(_MOST_SHOWN).index]
    print_rows(
        ("largest, as a share of its tolerance", *largest),
        [(name, *(f"{share:.0e}" for share in shares)) for name, *shares in shown.itertuples()],
    )
    print(*failures, sep="\n")
    return 1 if failures else 0


def _probe(variables: Mapping[str, str], out: Path, examples: str) -> dict[str, Any]:
    _require(_run(variables, "tests.processors.probes", str(out), examples))
    found: dict[str, Any] = json.loads(out.read_text(encoding="utf-8"))
    return found


def _test(variables: Mapping[str, str]) -> tuple[list[str], str]:
    """Run the tests that are marked; return the lines of failures, and what pytest says at its end."""
    files = [str(path) for path in sorted(_TESTS.rglob("test_*.py")) if "mark.processors" in path.read_text()]
    done = _run(variables, "pytest", "-q", "-p", "no:cacheprovider", "-m", "processors", *files)
    lines = done.stdout.splitlines()
    failures = [line for line in lines if line.startswith(("FAILED", "ERROR"))]
    return failures or (lines[-20:] if done.returncode else []), lines[-1]


def _run(variables: Mapping[str, str], module: str, *words: str) -> "subprocess.CompletedProcess[str]":
    return subprocess.run(
        [sys.executable, "-m", module, *words],
        cwd=_TESTS.parent, env={**os.environ, **_ALWAYS, **variables}, capture_output=True, text=True, check=False,
    )  # fmt: skip


def _require(done: "subprocess.CompletedProcess[str]") -> None:
    if done.returncode != 0:
        raise RuntimeError(f"{' '.join(done.args)} failed:\n{done.stderr}")


def _compare(default: Mapping[str, Any], here: Mapping[str, Any]) -> dict[str, Agreement]:
    """Return how each result agrees with that of the default environment."""
    return {
        name: compare_results({"result": result}, {"result": here["results"][name]})
        for name, result in default["results"].items()
    }


def _find_largest(default: Mapping[str, Any], here: Mapping[str, Any]) -> dict[str, float]:
    """Return the largest difference of each quantity as a share of its tolerance."""
    largest: dict[str, float] = {}
    for each in _compare(default, here).values():
        for name, share in each.shares.items():
            largest[name] = max(share, largest.get(name, 0.0))
    return largest


def _find_otherwise(environment: str, default: Mapping[str, Any], here: Mapping[str, Any]) -> Iterator[str]:
    """Yield the results and replays that are not what they must be."""
    for name, each in _compare(default, here).items():
        if each.first is not None:
            yield f"{name}: {each.first.path} is {each.first.recorded} here, {each.first.now} there"
        for quantity, share in each.shares.items():
            if share > (1.0 if _LENS in quantity else _MOST_SHARE):
                yield f"{name}: {quantity} differs by {share:.2f} of its tolerance"
    for name, verdict in here["replays"].items():
        identical = environment == DEFAULT and name.startswith("example")
        if verdict not in ({"identical"} if identical else {"identical", "equivalent"}):
            yield f"{name}: {verdict}"


if __name__ == "__main__":
    sys.exit(main())
