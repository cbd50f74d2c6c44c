"""The sweep of 72 insertions: time, memory, accuracy against the drawn truth, and identity of a second sweep.

With `LABRIG_BENCHMARK_BASELINE=CHECKOUT`, another checkout with a `.venv` of its own, it prints instead what a sweep of
24 insertions costs here and there, in turns: processor time of the whole command and its children.
"""

import hashlib
import json
import math
import os
import statistics
import subprocess
import sys
import tempfile
from collections import defaultdict
from pathlib import Path
from typing import Any

from tests.benchmarks.table import FinishedCommand, measure, print_rows

ROOT = Path(__file__).parents[2]
_BASELINE = "LABRIG_BENCHMARK_BASELINE"
_TURNS = 5


def print_table() -> None:
    """Run the sweep twice, and print the figures of the first and whether the second has the same bytes.

    If a baseline is named, print the cost against it instead.
    """
    if _BASELINE in os.environ:
        _print_cost_against(Path(os.environ[_BASELINE]))
        return
    with tempfile.TemporaryDirectory() as folder:
        runs = [_sweep(Path(folder) / str(number)) for number in (1, 2)]
        measured, document = runs[0]
        rows = [
            ["wall time, s", f"{measured.wall_s:.1f}", "60"],
            ["peak memory, MB (pss, all processes)", f"{measured.peak_mb:.0f}", "600"],
            *_accuracy(document),
        ]
        print_rows(("figure", "measured", "limit"), rows)
        print_rows(("gel", "n", "mean mm", "drawn mean mm", "difference mm", "limit"), _means(document))
        same = _digest(Path(document["run"])) == _digest(Path(runs[1][1]["run"]))
        print(f"second sweep, same seed: frames, states and events {'identical' if same else 'DIFFER'}")


def _print_cost_against(baseline: Path) -> None:
    """Print the processor time of a short sweep here and in another checkout, measured in turns."""
    pythons = {ROOT: Path(sys.executable), baseline: baseline / ".venv" / "bin" / "python"}
    for root, python in pythons.items():
        subprocess.run([python, "-m", "compileall", "-q", "labrig"], cwd=root, check=True)
    turns = [{root: _measure_cpu_s(root, python) for root, python in pythons.items()} for _ in range(_TURNS)]
    here, there = ([turn[root] for turn in turns] for root in (ROOT, baseline))
    rows = [
        [name, f"{of(here):.2f}", f"{of(there):.2f}", f"{of(here) / of(there):.3f}"]
        for name, of in (("least", min), ("median", statistics.median))
    ]
    print_rows((f"cpu of {_TURNS} sweeps, s", "here", "baseline", "ratio"), rows)


def _measure_cpu_s(root: Path, python: Path) -> float:
    """Return the processor time of a sweep of 24 insertions by the labrig of a checkout [s]."""
    with tempfile.TemporaryDirectory() as runs_dir:
        command = [python, "-m", "labrig", "run", "protocols/steerability.yaml", "--runs-dir", runs_dir]
        return measure([*command, "--set", "insertions_per_specimen=6"], cwd=root).cpu_s


def _sweep(runs_dir: Path) -> tuple[FinishedCommand, dict[str, Any]]:
    protocol, rig = ROOT / "protocols" / "steerability.yaml", ROOT / "calibration" / "rig-simulated.yaml"
    files = [str(protocol), "--rig", str(rig), "--runs-dir", str(runs_dir)]
    command = [sys.executable, "-m", "labrig", "run", *files]
    measured = measure([*command, "--json"], memory=True)
    return measured, json.loads(measured.out)


def _read_truth(run: Path) -> dict[int, dict[str, Any]]:
    lines = (json.loads(line) for line in (run / "truth.jsonl").read_text(encoding="utf-8").splitlines())
    return {line["trial"]: line for line in lines}


def _finals(document: dict[str, Any]) -> list[dict[str, Any]]:
    return [line for line in document["result"]["measurements"] if line["role"] == "final"]


def _accuracy(document: dict[str, Any]) -> list[list[str]]:
    truth = _read_truth(Path(document["run"]))
    finals = _finals(document)
    errors = [line["radius_mm"] - truth[line["trial"]]["radius_mm"] for line in finals if line["accepted"]]
    refused = sum(not line["accepted"] for line in finals)
    covered = sum(
        line["radius_ci95_mm"][0] <= truth[line["trial"]]["radius_mm"] <= line["radius_ci95_mm"][1]
        for line in finals
        if line["accepted"]
    )
    return [
        ["worst error of a picture, mm", f"{max(map(abs, errors)):.3f}", "0.25"],
        ["mean error of the pictures, mm", f"{sum(errors) / len(errors):+.4f}", "-"],
        [f"refused, of {len(finals)}", str(refused), "1"],
        [f"95 % intervals that hold the truth, of {len(errors)}", str(covered), "-"],
        *_sheaths(document, truth),
    ]


def _sheaths(document: dict[str, Any], truth: dict[int, dict[str, Any]]) -> list[list[str]]:
    """Return the errors of the sheath's tip, and how many trials are refused for it."""
    origins = document["result"]["origins"]
    off_mm = [math.dist(line["tip_mm"], truth[line["trial"]]["sheath_tip_mm"]) for line in origins]
    refused = sum(not line["accepted"] for line in origins)
    return [
        ["sheath's tip found, worst error mm", f"{max(off_mm):.3f}", "0.05"],
        [f"sheaths refused, of {len(origins)}", str(refused), "0"],
    ]


def _means(document: dict[str, Any]) -> list[list[str]]:
    drawn = defaultdict(list)
    for line in _read_truth(Path(document["run"])).values():
        drawn[line["specimen"]].append(line["radius_mm"])
    rows = []
    for specimen in document["result"]["specimens"]:
        truth = sum(drawn[specimen["name"]]) / len(drawn[specimen["name"]])
        mean = specimen["mean_radius_mm"]
        found = (f"{mean:.3f}", f"{truth:.3f}", f"{mean - truth:+.4f}")
        rows.append([specimen["name"], str(specimen["n"]), *found, "0.05"])
    return rows


def _digest(run: Path) -> str:
    digest = hashlib.sha256()
    for path in [*sorted((run / "frames").iterdir()), run / "states.jsonl", run / "events.jsonl"]:
        digest.update(path.name.encode() + path.read_bytes())
    return digest.hexdigest()
