"""How often the 95 % intervals of radius and tip hold the truth, by radius and by light, and what they consist of.

The renderer is `tests/vision/renderer.py`, which shares nothing with labrig. One picture in four is lit evenly, the
others have a lamp beside the needle. The scale is given exactly, so that lens, plane, surface and roll have no part:
the interval of a radius rests on the scatter of the edges and on what light does to them, alone. That of a tip is a
disc of 1.96 standard deviations.
"""

import os
import sys
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context
from typing import get_args

import cv2
import numpy as np
import pandas as pd

from labrig.vision.curvature import CurvatureSettings, measure_curvature
from labrig.vision.plane import PlaneMap
from tests.benchmarks.table import multiply, print_rows
from tests.vision.renderer import Light, draw_side_lit

RENDERS = multiply(20)
BANDS_MM = ((20.0, 30.0), (30.0, 40.0), (40.0, 60.0))
LIGHTS: tuple[Light, ...] = get_args(Light)
FIRST_SEED = 50_000
NORMAL_95 = 1.96
COLUMNS = (
    "band", "light", "radius_error", "radius_sigma", "radius_held", "fit", "lighting", "shift",
    "tip_error", "tip_sigma", "tip_held",
)  # fmt: skip


def measure_render(band: int, number: int) -> dict[str, float | str]:
    """Draw a needle, measure it, and return its band and light, and what was found by its error and error bar [mm].

    `shift` is the mean distance of the measured centre line from the true arc, outwards. What was not accepted, or a
    tip where no shaft is found, has no figures.
    """
    light = LIGHTS[number % len(LIGHTS)]
    gel = draw_side_lit(FIRST_SEED + number, BANDS_MM[band], light)
    needle, camera = gel.needle, gel.camera
    assert needle is not None
    plane = PlaneMap.from_scale(camera.px_per_mm, (0.0, 0.0), "right")
    found = measure_curvature(gel.draw(), plane, CurvatureSettings())
    budget, interval = found.radius_budget_mm, found.radius_ci95_mm
    row: dict[str, float | str] = {"band": band, "light": light}
    if found.tip_px is not None and found.tip_budget_mm is not None:
        off_mm = float(np.hypot(*(camera.to_mm([found.tip_px])[0] - needle.tip_mm)))
        sigma_mm = found.tip_budget_mm.total
        row |= {"tip_error": off_mm, "tip_sigma": sigma_mm, "tip_held": off_mm <= NORMAL_95 * sigma_mm}
    if found.accepted and found.radius_mm is not None and budget is not None and interval is not None:
        away = np.hypot(*(camera.to_mm(found.line.px[slice(*found.line.window)]) - needle.centre_mm).T)
        row |= {
            "radius_error": found.radius_mm - needle.radius_mm, "radius_sigma": budget.total,
            "radius_held": interval[0] <= needle.radius_mm <= interval[1], "fit": budget.fit or 0.0,
            "lighting": budget.lighting or 0.0, "shift": float(away.mean()) - needle.radius_mm,
        }  # fmt: skip
    return row


def print_table() -> None:
    """Print coverage, error and error bar by band of radius and by light; progress goes to standard error."""
    cv2.setNumThreads(1)
    rows: list[dict[str, float | str]] = []
    with ProcessPoolExecutor(os.cpu_count(), get_context("fork")) as pool:
        for band, (low, high) in enumerate(BANDS_MM):
            rows += pool.map(partial(measure_render, band), range(RENDERS), chunksize=10)
            print(f"coverage: {RENDERS} pictures of {low:g} to {high:g} mm", file=sys.stderr)
    table = pd.DataFrame(rows, columns=COLUMNS)
    same = ("light", "pictures", "accepted", "in the interval", "error, rms mm", "stated, rms mm", "ratio")
    parts = ("fit, median mm", "lighting, median mm", "shift, rms mm")
    print_rows(("radius", *same, *parts), _list_rows(table, "radius"))
    print_rows(("tip, by radius", *same), _list_rows(table, "tip"))
    print(f"seeds {FIRST_SEED} to {FIRST_SEED + RENDERS - 1}; wanted: 93 to 97 % in each band")


def _list_rows(table: pd.DataFrame, what: str) -> list[list[object]]:
    rows: list[list[object]] = []
    for band, (low, high) in enumerate(BANDS_MM):
        own = table[table["band"] == band]
        rows.append([f"{low:g}-{high:g} mm", "all", *_summarise(own, what)])
        rows += [["", light, *_summarise(own[own["light"] == light], what)] for light in LIGHTS]
    return rows


def _summarise(table: pd.DataFrame, what: str) -> list[object]:
    found = table.dropna(subset=f"{what}_error")
    if found.empty:
        return [len(table), 0, *("-" for _ in range(7 if what == "radius" else 4))]
    error, sigma, shift = (_rms(found[name]) for name in (f"{what}_error", f"{what}_sigma", "shift"))
    held = found[f"{what}_held"].mean()
    figures = [len(table), len(found), f"{held:.1%}", f"{error:.4f}", f"{sigma:.4f}", f"{sigma / error:.2f}"]
    parts = (found["fit"].median(), found["lighting"].median(), shift) if what == "radius" else ()
    return [*figures, *(f"{value:.4f}" for value in parts)]


def _rms(values: "pd.Series[float]") -> float:
    return float(np.sqrt(np.mean(values**2)))
