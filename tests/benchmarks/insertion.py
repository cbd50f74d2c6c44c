"""The closed loop with camera, bus and record: `labrig run protocols/insertion.yaml` for twenty seeds."""

import json
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from tests.benchmarks.table import FinishedCommand, measure, print_rows

ROOT = Path(__file__).parents[2]
SEEDS = range(1, 21)
LARGEST_ERROR_MM = 1.0
LONGEST_S = 15.0


def print_table(seeds: Sequence[int] = SEEDS) -> None:
    """Run every seed, and print its figures and how many seeds keep the limits."""
    rows, errors_mm, walls_s, held = [], [], [], 0
    with tempfile.TemporaryDirectory() as folder:
        for seed in seeds:
            measured, document = _run(Path(folder), seed)
            result = document.get("result") or {}
            error_mm = result.get("true_target_error_mm")
            errors_mm.append(float("inf") if error_mm is None else error_mm)
            walls_s.append(measured.wall_s)
            held += _holds(result)
            rows.append(_row(seed, measured, document, result))
    heads = (
        "seed",
        "exit status",
        "reason",
        "true error mm",
        "measured mm",
        "clearance mm",
        "turns",
        "wall s",
    )
    print_rows(heads, rows)
    known = [error for error in errors_mm if error < float("inf")]
    print_rows(
        ("figure", "measured", "limit"),
        [
            [f"within {LARGEST_ERROR_MM:g} mm", sum(e <= LARGEST_ERROR_MM for e in errors_mm), len(seeds)],
            ["mean true error, mm", f"{sum(known) / max(len(known), 1):.3f}", "0.4"],
            [f"95 % intervals in space that hold the true error, of {len(seeds)}", held, "-"],
            ["longest wall time, s", f"{max(walls_s):.1f}", f"{LONGEST_S:g}"],
        ],
    )


def _run(runs_dir: Path, seed: int) -> tuple[FinishedCommand, dict[str, Any]]:
    protocol, rig = ROOT / "protocols" / "insertion.yaml", ROOT / "calibration" / "rig-simulated.yaml"
    where = ["--rig", str(rig), "--runs-dir", str(runs_dir), "--run-name", f"seed-{seed}"]
    command = [sys.executable, "-m", "labrig", "run", str(protocol), *where, "--seed", str(seed), "--json"]
    measured = measure(command)
    return measured, json.loads(measured.out)


def _row(seed: int, measured: FinishedCommand, document: dict[str, Any], result: dict[str, Any]) -> list[str]:
    figures = ("true_target_error_mm", "target_error_mm", "true_min_clearance_mm")
    return [
        str(seed),
        str(document.get("exit_status")),
        str(document.get("reason") or "-"),
        *("-" if result.get(name) is None else f"{result[name]:.3f}" for name in figures),
        str(_count_turns(Path(document["run"]))) if "run" in document else "-",
        f"{measured.wall_s:.1f}",
    ]


def _holds(result: dict[str, Any]) -> bool:
    """Return whether the true error lies in its interval in space."""
    true_mm, interval_mm = (
        result.get(f"{name}_mm") for name in ("true_target_error", "target_error_interval")
    )
    return None not in (true_mm, interval_mm) and interval_mm[0] <= true_mm <= interval_mm[1]


def _count_turns(run: Path) -> int:
    """Return the number of turns of the bevel in tissue."""
    lines = (run / "events.jsonl").read_text(encoding="utf-8").splitlines()
    events = (json.loads(line) for line in lines)
    return sum(event["kind"] == "flip" and event["depth_mm"] > 0 for event in events)
