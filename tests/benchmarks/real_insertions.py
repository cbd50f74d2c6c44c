"""Photographs of a real needle: tips and ruled lines against marks made by eye, and steps from frame to frame.

The needles are nearly straight and no radius is known: this tests the tip and no radius. `marks/real_tips.csv` holds
the tips of all 85 frames in pixels, read by one observer off crops enlarged six times, twice, in two shuffled orders
and with other crops, before labrig measured these frames again. A mark is where the darkness of the shaft has faded by
half. The two marks of a frame are apart by 0.54 px (median), 1.22 px (95 %) and 1.58 px (worst).
`marks/real_insertion_lines.csv` holds the ten-millimetre lines down two frames of each folder, read off strips enlarged
four times.
"""

import csv
import json
import math
import sys
from itertools import groupby, pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from labrig.vision.calibrate_plane import fit_plane
from labrig.vision.paper import find_paper
from labrig.vision.picture import read_picture
from tests.benchmarks.table import measure, print_rows

PICTURES = Path(__file__).parents[3] / "shared" / "data" / "real_insertions"
MARKS = Path(__file__).with_name("marks")
PX_PER_MM = 5.607
# The nearest lines: fainter ones run between those that are 10 mm apart.
PITCH_MM = 5.0
# A point this far off the plane is a mismatch.
GROSS_MM = 1.25
STEP_MM = 8.0
NORMAL_95 = 1.96
WITHIN_MM = 1.0
# A tip this far off is not the needle's.
ASTRAY_MM = 5.0


class MarkedTip(NamedTuple):
    """The two marks (u, v) [px] of the tip in a frame of a trial."""

    trial: str
    frame: int
    marks_px: NDArray[np.float64]


def _read_marked_tips() -> list[MarkedTip]:
    """Return the marks of all frames, in the order of trials and frames."""
    with (MARKS / "real_tips.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.reader(file))[1:]
    return [MarkedTip(trial, int(frame), np.array(px, float).reshape(2, 2)) for trial, frame, *px in rows]


def print_table() -> None:
    """Print tips against their marks, steps within 1 mm of 8 mm, and which are off and why."""
    if not PICTURES.is_dir():
        print(f"skipped: {PICTURES} is not here")
        return
    marks = _read_marked_tips()
    measured = _measure([PICTURES / mark.trial / f"ImgFeedback{mark.frame}.jpg" for mark in marks])
    errors = [_error_mm(tip, mark) for tip, mark in zip(measured, marks, strict=True)]
    found = sorted(error for error in errors if error is not None)
    near = sum(error <= WITHIN_MM for error in found)
    spreads = np.array([math.dist(*mark.marks_px) for mark in marks]) / PX_PER_MM
    steps = _measure_steps(marks, measured)
    good = sum(abs(step - STEP_MM) <= WITHIN_MM for step in steps if step is not None)
    off = _compare_lines()
    rows: list[list[object]] = [
        [f"tips within 1 mm of the mean mark, of {len(marks)}", near, "84"],
        ["tips found more than 5 mm off", sum(error > ASTRAY_MM for error in found), "0"],
        ["frames refused", len(marks) - len(found), "-"],
        ["error of the tip, mm: median, 95 %, worst", _summarize(np.array(found)), "-"],
        ["two marks of a frame apart, mm: the same", _summarize(spreads), "-"],
        ["95 % intervals of the tip that hold the mean mark, %", _share_held(measured, errors), "-"],
        [f"steps within 1 mm of 8 mm, % of {len(steps)}", f"{100.0 * good / len(steps):.1f}", "90"],
        [
            f"ten-millimetre lines in {len(off)} frames, % off the marked ones at most",
            f"{max(off):.2f}",
            "0.5",
        ],
        ["radii accepted", sum(tip["accepted"] for tip in measured), "0"],
    ]
    print_rows(("figure", "measured", "wanted"), rows)
    print("The needles are nearly straight: these frames test the tip and no radius.")
    for mark, tip, error in zip(marks, measured, errors, strict=True):
        if error is None or error > WITHIN_MM:
            told = tip["reason"] if error is None else f"{error:.2f} mm off"
            print(f"{mark.trial.replace('_feedbackfinal', '')} frame {mark.frame}: {told}")


def _measure(pictures: list[Path]) -> list[dict[str, Any]]:
    command = [sys.executable, "-m", "labrig", "measure", "curvature", *map(str, pictures)]
    mapping = ["--px-per-mm", str(PX_PER_MM), "--origin-px", "70", "50", "--insertion", "down"]
    needle = ["--needle-diameter-mm", "1", "--json"]
    measured: list[dict[str, Any]] = json.loads(measure([*command, *mapping, *needle]).out)
    return measured


def _error_mm(measured: dict[str, Any], mark: MarkedTip) -> float | None:
    if not measured["found"]:
        return None
    return math.dist(measured["tip_px"], mark.marks_px.mean(axis=0)) / PX_PER_MM


def _share_held(measured: list[dict[str, Any]], errors: list[float | None]) -> str:
    """Return how many percent of the tips are off their mark by no more than 1.96 standard deviations."""
    held = [
        error <= NORMAL_95 * math.hypot(*(sigma or 0.0 for sigma in tip["tip_budget_mm"].values()))
        for tip, error in zip(measured, errors, strict=True)
        if error is not None
    ]
    return f"{100.0 * float(np.mean(held)):.1f}"


def _summarize(values: NDArray[np.float64]) -> str:
    return f"{np.median(values):.2f}, {np.percentile(values, 95):.2f}, {values.max():.2f}"


def _measure_steps(marks: list[MarkedTip], measured: list[dict[str, Any]]) -> list[float | None]:
    """Return the tip's steps [mm] from frame to frame of a trial, None if a frame has no tip."""
    tips = [picture["tip_mm"] if picture["found"] else None for picture in measured]
    return [
        None if before is None or after is None else math.dist(before, after)
        for (earlier, before), (later, after) in pairwise(zip(marks, tips, strict=True))
        if earlier.trial == later.trial
    ]


def _compare_lines() -> list[float]:
    """Return by how many percent the distance of marked lines is off, in each frame."""
    with (MARKS / "real_insertion_lines.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.reader(file))[1:]
    off = []
    for (folder, name), lines in groupby(rows, key=lambda row: row[:2]):
        found = find_paper(read_picture(PICTURES / folder / name), PITCH_MM * PX_PER_MM)
        fit = fit_plane(found.pixels, PITCH_MM * found.lines, GROSS_MM)
        marked = np.array([row[2:] for row in lines], dtype=float)
        length_mm = math.dist(*fit.paper_mm(marked[[0, -1], 1:]))
        off.append(100.0 * abs(length_mm / (10.0 * marked[-1, 0]) - 1.0))
    return off
