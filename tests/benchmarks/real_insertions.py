"""Tips found in photographs of a real needle beside marks made by eye."""

import csv
import json
import math
import subprocess
import sys
from pathlib import Path
from typing import Any

from tests.benchmarks.table import print_rows

PICTURES = Path(__file__).parents[3] / "shared" / "data" / "real_insertions"
MARKS = Path(__file__).parents[1] / "vision" / "marks" / "real_insertion_tips.csv"
PX_PER_MM = 5.607


def print_table() -> None:
    """How many of the marked frames have their tip within 1.5 mm of the mark, and how many state a radius."""
    if not PICTURES.is_dir():
        print(f"skipped: {PICTURES} is not here")
        return
    with MARKS.open(encoding="utf-8", newline="") as file:
        marks = list(csv.DictReader(file))
    measured = _measure([PICTURES / mark["folder"] / mark["file"] for mark in marks])
    errors = [_error_mm(one, mark) for one, mark in zip(measured, marks, strict=True)]
    found = sorted(error for error in errors if error is not None)
    near = sum(error <= 1.5 for error in found)
    rows = [
        [f"tip within 1.5 mm of the mark, of {len(marks)}", near, "38"],
        ["found", len(found), "-"],
        ["median error of the tip, mm", f"{found[len(found) // 2]:.2f}", "-"],
        ["worst, mm", f"{found[-1]:.2f}", "-"],
        ["radii stated as worth it", sum(one["accepted"] for one in measured), "0"],
    ]
    print_rows(("figure", "measured", "wanted"), rows)


def _measure(pictures: list[Path]) -> list[dict[str, Any]]:
    command = [sys.executable, "-m", "labrig", "measure", "curvature", *map(str, pictures)]
    mapping = [
        "--px-per-mm",
        str(PX_PER_MM),
        "--origin-px",
        "70",
        "50",
        "--insertion",
        "down",
        "--needle-diameter-mm",
        "1",
    ]
    done = subprocess.run([*command, *mapping, "--json"], check=False, capture_output=True, text=True)
    measured: list[dict[str, Any]] = json.loads(done.stdout)
    return measured


def _error_mm(measured: dict[str, Any], mark: dict[str, str]) -> float | None:
    if not measured["found"]:
        return None
    u, v = measured["tip_px"]
    return math.hypot(u - float(mark["u_px"]), v - float(mark["v_px"])) / PX_PER_MM
