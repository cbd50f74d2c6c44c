"""Photographs of a real needle: tips beside marks made by eye, steps from frame to frame, and the scale."""

import csv
import json
import math
import subprocess
import sys
from collections import Counter
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from labrig.errors import MeasurementRefusedError
from labrig.vision import read_picture
from labrig.vision.graph_paper import find_crossings
from tests.benchmarks.table import print_rows

PICTURES = Path(__file__).parents[3] / "shared" / "data" / "real_insertions"
MARKS = Path(__file__).parents[1] / "vision" / "marks" / "real_insertion_tips.csv"
PX_PER_MM = 5.607
# The finest lines: fainter ones run between those that are 10 mm apart.
PITCH_MM = 5.0
LEAST_CROSSINGS = 100
STEP_MM = 8.0
WITHIN_MM = 1.0


def print_table() -> None:
    """Tips within a millimetre of their marks, steps within a millimetre of eight, and why the rest are not."""
    if not PICTURES.is_dir():
        print(f"skipped: {PICTURES} is not here")
        return
    with MARKS.open(encoding="utf-8", newline="") as file:
        marks = list(csv.DictReader(file))
    measured = _measure([PICTURES / mark["folder"] / mark["file"] for mark in marks])
    found = sorted(
        error
        for one, mark in zip(measured, marks, strict=True)
        if (error := _error_mm(one, mark)) is not None
    )
    near = sum(error <= WITHIN_MM for error in found)
    steps, reasons = _steps()
    good = sum(abs(step - STEP_MM) <= WITHIN_MM for step in steps if step is not None)
    scales = _scales()
    rows: list[list[object]] = [
        [f"tip within 1 mm of the mark, % of {len(marks)}", f"{100.0 * near / len(marks):.1f}", "95"],
        ["median error of the tip, mm", f"{found[len(found) // 2]:.2f}", "-"],
        ["worst of those found, mm", f"{found[-1]:.2f}", "-"],
        [f"steps within 1 mm of 8 mm, % of {len(steps)}", f"{100.0 * good / len(steps):.1f}", "90"],
        [f"scale from the ruled lines, % off, {len(scales)} frames", f"{_off_percent(scales):+.2f}", "1"],
        ["radii stated as worth it", sum(one["accepted"] for one in measured), "0"],
    ]
    print_rows(("figure", "measured", "wanted"), rows)
    print("steps that are not: " + "; ".join(f"{count} {why}" for why, count in reasons.most_common()))


def _measure(pictures: list[Path]) -> list[dict[str, Any]]:
    command = [sys.executable, "-m", "labrig", "measure", "curvature", *map(str, pictures)]
    mapping = ["--px-per-mm", str(PX_PER_MM), "--origin-px", "70", "50", "--insertion", "down"]
    needle = ["--needle-diameter-mm", "1", "--json"]
    done = subprocess.run([*command, *mapping, *needle], check=False, capture_output=True, text=True)
    measured: list[dict[str, Any]] = json.loads(done.stdout)
    return measured


def _error_mm(measured: dict[str, Any], mark: dict[str, str]) -> float | None:
    if not measured["found"]:
        return None
    u, v = measured["tip_px"]
    return math.hypot(u - float(mark["u_px"]), v - float(mark["v_px"])) / PX_PER_MM


def _steps() -> tuple[list[float | None], Counter[str]]:
    """Return the tip's steps [mm], None where one of two frames has none, and why steps are not what they should be."""
    steps: list[float | None] = []
    reasons: Counter[str] = Counter()
    for folder in sorted(PICTURES.glob("DC_*")):
        files = sorted(folder.glob("*.jpg"), key=lambda path: int("".join(filter(str.isdigit, path.stem))))
        tips = [one["tip_mm"] if one["found"] else None for one in _measure(files)]
        for number, (before, after) in enumerate(pairwise(tips), start=2):
            step = None if before is None or after is None else math.dist(before, after)
            steps.append(step)
            if step is None or abs(step - STEP_MM) > WITHIN_MM:
                reasons[_why(folder.name, number, step, before)] += 1
    return steps, reasons


def _why(folder: str, number: int, step: float | None, before: list[float] | None) -> str:
    place = f"{folder.split('_feedback', maxsplit=1)[0]} frame {number}"
    if step is None:
        return f"({place}) no tip in the frame{' before' if before is None else ''}"
    return f"({place}) of {step:.1f} mm"


def _scales() -> list[float]:
    """Return px/mm along the insertion from the ruled lines of each frame in which enough of them are found."""
    scales = []
    for path in sorted(PICTURES.glob("DC_*/*.jpg")):
        try:
            found = find_crossings(read_picture(path))
        except MeasurementRefusedError:
            continue
        if len(found.pixels) >= LEAST_CROSSINGS:
            design = np.column_stack((found.indices, np.ones(len(found.indices))))
            steps = np.linalg.lstsq(design, found.pixels, rcond=None)[0][:2]
            scales.append(float(np.abs(steps[:, 1]).max()) / PITCH_MM)
    return scales


def _off_percent(scales: list[float]) -> float:
    return float(100.0 * (np.median(scales) / PX_PER_MM - 1.0)) if scales else float("nan")
