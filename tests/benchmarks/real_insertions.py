"""Photographs of a real needle: tips against marks made by eye, steps from frame to frame, and the scale.

The needles are nearly straight and no radius is known: this tests the tip and no radius.
"""

import json
import math
import subprocess
import sys
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labrig.errors import MeasurementRefusedError
from labrig.vision.calibrate_plane import fit_plane
from labrig.vision.paper import find_paper
from labrig.vision.picture import read_picture, size_of
from tests.benchmarks.table import print_rows
from tests.vision.real_tips import PICTURES, MarkedTip, read_marked_tips

PX_PER_MM = 5.607
# The nearest lines: fainter ones run between those that are 10 mm apart.
PITCH_MM = 5.0
LEAST_POINTS = 50
# A point this far off the plane is a mismatch.
GROSS_MM = 1.25
# The needle's path, in shares of the picture's width and height.
PATH = ((0.2, 0.15), (0.5, 0.9))
STEP_MM = 8.0
NORMAL_95 = 1.96
WITHIN_MM = 1.0
# A tip this far off is not the needle's.
ASTRAY_MM = 5.0


def print_table() -> None:
    """Print tips against their marks, steps within 1 mm of 8 mm, and which are off and why."""
    if not PICTURES.is_dir():
        print(f"skipped: {PICTURES} is not here")
        return
    marks = read_marked_tips()
    measured = _measure([mark.picture for mark in marks])
    errors = [_error_mm(tip, mark) for tip, mark in zip(measured, marks, strict=True)]
    found = sorted(error for error in errors if error is not None)
    near = sum(error <= WITHIN_MM for error in found)
    spreads = np.array([mark.spread_px for mark in marks]) / PX_PER_MM
    steps = _measure_steps(marks, measured)
    good = sum(abs(step - STEP_MM) <= WITHIN_MM for step in steps if step is not None)
    ours = _find_scales()
    rows: list[list[object]] = [
        [f"tips within 1 mm of the mean mark, of {len(marks)}", near, "84"],
        ["tips found more than 5 mm off", sum(error > ASTRAY_MM for error in found), "0"],
        ["frames refused", len(marks) - len(found), "-"],
        ["error of the tip, mm: median, 95 %, worst", _summarize(np.array(found)), "-"],
        ["two marks of a frame apart, mm: the same", _summarize(spreads), "-"],
        ["95 % intervals of the tip that hold the mean mark, %", _share_held(measured, errors), "-"],
        [f"steps within 1 mm of 8 mm, % of {len(steps)}", f"{100.0 * good / len(steps):.1f}", "90"],
        [f"frames with ruled lines found, of {len(marks)}", len(ours), "-"],
        ["scale on the needle's path by the ruled lines, % off 5.607", _off_percent(ours), "1"],
        ["radii accepted", sum(tip["accepted"] for tip in measured), "0"],
    ]
    print_rows(("figure", "measured", "wanted"), rows)
    print("The needles are nearly straight: these frames test the tip and no radius.")
    for mark, tip, error in zip(marks, measured, errors, strict=True):
        if error is None or error > WITHIN_MM:
            told = tip["reason"] if error is None else f"{error:.2f} mm off"
            print(f"{_name_frame(mark)}: {told}")


def _measure(pictures: list[Path]) -> list[dict[str, Any]]:
    command = [sys.executable, "-m", "labrig", "measure", "curvature", *map(str, pictures)]
    mapping = ["--px-per-mm", str(PX_PER_MM), "--origin-px", "70", "50", "--insertion", "down"]
    needle = ["--needle-diameter-mm", "1", "--json"]
    done = subprocess.run([*command, *mapping, *needle], check=False, capture_output=True, text=True)
    measured: list[dict[str, Any]] = json.loads(done.stdout)
    return measured


def _error_mm(measured: dict[str, Any], mark: MarkedTip) -> float | None:
    if not measured["found"]:
        return None
    return math.dist(measured["tip_px"], mark.mean_px) / PX_PER_MM


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


def _name_frame(mark: MarkedTip) -> str:
    return f"{mark.trial.replace('_feedbackfinal', '')} frame {mark.frame}"


def _measure_steps(marks: list[MarkedTip], measured: list[dict[str, Any]]) -> list[float | None]:
    """Return the tip's steps [mm] from frame to frame of a trial, None if a frame has no tip."""
    tips = [picture["tip_mm"] if picture["found"] else None for picture in measured]
    return [
        None if before is None or after is None else math.dist(before, after)
        for (earlier, before), (later, after) in pairwise(zip(marks, tips, strict=True))
        if earlier.trial == later.trial
    ]


def _find_scales() -> list[float]:
    """Return px/mm on the needle's path of each frame in which ruled lines are found."""
    scales = []
    for path in sorted(PICTURES.glob("DC_*/*.jpg")):
        picture = read_picture(path)
        try:
            found = find_paper(picture, PITCH_MM * PX_PER_MM)
        except MeasurementRefusedError:
            continue
        if len(found.pixels) >= LEAST_POINTS:
            fit, ends_px = (
                fit_plane(found.pixels, PITCH_MM * found.lines, GROSS_MM),
                np.array(PATH) * size_of(picture),
            )
            px, mm = (math.dist(*ends) for ends in (ends_px, fit.paper_mm(ends_px)))
            scales.append(px / mm)
    return scales


def _off_percent(scales: list[float]) -> str:
    return f"{100.0 * (np.median(scales) / PX_PER_MM - 1.0):+.2f}" if scales else "-"
