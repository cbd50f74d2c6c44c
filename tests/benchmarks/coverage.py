"""How often the 95 % intervals of radius and tip hold the truth, by radius and by light, and what they consist of.

`python -m tests.benchmarks coverage`; the number of pictures in each band of radius is `LABRIG_BENCHMARK_RENDERS`, 100
unless set. The renderer is `tests/vision/renderer.py`, which shares nothing with labrig. One picture in four is
lit evenly, the others have a lamp beside the needle. The scale is given exactly, so that lens, plane, surface and roll
have no part: the interval of a radius rests on the scatter of the edges and on what light does to them, alone. That
of a tip is a disc of 1.96 standard deviations.
"""

import os
import sys
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from multiprocessing import get_context
from typing import get_args

import cv2
import numpy as np

from labrig.vision.curvature import CurvatureSettings, measure_curvature
from labrig.vision.plane import PlaneMap
from tests.benchmarks.table import print_rows, read_count
from tests.vision.renderer import Light, draw_side_lit

RENDERS = read_count("RENDERS", 100)
BANDS_MM = ((20.0, 30.0), (30.0, 40.0), (40.0, 60.0))
LIGHTS: tuple[Light, ...] = get_args(Light)
FIRST_SEED = 50_000
NORMAL_95 = 1.96


@dataclass(frozen=True)
class Outcome:
    """One picture: its band and light, and, if a radius is accepted, its error, its error bar and what that holds [mm].

    `shift_mm` is the mean distance of the measured centre line from the true arc, outwards. `tip_error_mm` is the
    distance of the tip from the true one; it is None if no shaft is found.
    """

    band: int
    light: Light
    error_mm: float | None = None
    held: bool = False
    sigma_mm: float = 0.0
    fit_mm: float = 0.0
    lighting_mm: float = 0.0
    shift_mm: float = 0.0
    tip_error_mm: float | None = None
    tip_sigma_mm: float = 0.0


def measure_render(band: int, number: int) -> Outcome:
    """Draw a needle, measure it and compare it with the truth."""
    light = LIGHTS[number % len(LIGHTS)]
    gel = draw_side_lit(FIRST_SEED + number, BANDS_MM[band], light)
    needle, camera = gel.needle, gel.camera
    assert needle is not None
    plane = PlaneMap.from_scale(camera.px_per_mm, (0.0, 0.0), "right")
    found = measure_curvature(gel.draw(), plane, CurvatureSettings())
    budget, interval = found.radius_budget_mm, found.radius_ci95_mm
    outcome = Outcome(band, light)
    if found.tip_px is not None and found.tip_budget_mm is not None:
        off_mm = float(np.hypot(*(camera.to_mm([found.tip_px])[0] - needle.tip_mm)))
        outcome = replace(outcome, tip_error_mm=off_mm, tip_sigma_mm=found.tip_budget_mm.total)
    if not found.accepted or found.radius_mm is None or budget is None or interval is None:
        return outcome
    away = np.hypot(*(camera.to_mm(found.line.px[slice(*found.line.window)]) - needle.centre_mm).T)
    return replace(
        outcome,
        error_mm=found.radius_mm - needle.radius_mm,
        held=interval[0] <= needle.radius_mm <= interval[1],
        sigma_mm=budget.total,
        fit_mm=budget.fit or 0.0,
        lighting_mm=budget.lighting or 0.0,
        shift_mm=float(away.mean()) - needle.radius_mm,
    )


def print_table() -> None:
    """Print coverage, error and error bar by band of radius and by light; progress goes to standard error."""
    cv2.setNumThreads(1)
    outcomes: list[Outcome] = []
    with ProcessPoolExecutor(os.cpu_count(), get_context("fork")) as pool:
        for band, (low, high) in enumerate(BANDS_MM):
            outcomes += pool.map(partial(measure_render, band), range(RENDERS), chunksize=10)
            print(f"coverage: {RENDERS} pictures of {low:g} to {high:g} mm", file=sys.stderr)
    same = ("light", "pictures", "accepted", "in the interval", "error, rms mm", "stated, rms mm", "ratio")
    parts = ("fit, median mm", "lighting, median mm", "shift, rms mm")
    print_rows(("radius", *same, *parts), _list_rows(outcomes, _summarise))
    print_rows(("tip, by radius", *same), _list_rows(outcomes, _summarise_tips))
    print(f"seeds {FIRST_SEED} to {FIRST_SEED + RENDERS - 1}; wanted: 93 to 97 % in each band")


def _list_rows(
    outcomes: list[Outcome], summarise: Callable[[list[Outcome]], list[object]]
) -> list[list[object]]:
    rows: list[list[object]] = []
    for band, (low, high) in enumerate(BANDS_MM):
        own = [outcome for outcome in outcomes if outcome.band == band]
        rows.append([f"{low:g}-{high:g} mm", "all", *summarise(own)])
        rows += [
            ["", light, *summarise([found for found in own if found.light == light])] for light in LIGHTS
        ]
    return rows


def _summarise_tips(outcomes: list[Outcome]) -> list[object]:
    found = [(each.tip_error_mm, each.tip_sigma_mm) for each in outcomes if each.tip_error_mm is not None]
    if not found:
        return [len(outcomes), 0, *("-" for _ in range(4))]
    errors, sigmas = np.array(found).T
    error, sigma = (float(np.sqrt(np.mean(values**2))) for values in (errors, sigmas))
    held = np.mean(errors <= NORMAL_95 * sigmas)
    return [len(outcomes), len(found), f"{held:.1%}", f"{error:.4f}", f"{sigma:.4f}", f"{sigma / error:.2f}"]


def _summarise(outcomes: list[Outcome]) -> list[object]:
    accepted = [outcome for outcome in outcomes if outcome.error_mm is not None]
    if not accepted:
        return [len(outcomes), 0, *("-" for _ in range(7))]
    parts = ("error_mm", "sigma_mm", "fit_mm", "lighting_mm", "shift_mm")
    values = np.array([[getattr(found, part) for part in parts] for found in accepted])
    error, sigma, _, _, shift = np.sqrt(np.mean(values**2, axis=0))
    _, _, fit, lighting, _ = np.median(values, axis=0)
    held = np.mean([outcome.held for outcome in accepted])
    return [
        len(outcomes), len(accepted), f"{held:.1%}", f"{error:.4f}", f"{sigma:.4f}", f"{sigma / error:.2f}",
        *(f"{value:.4f}" for value in (fit, lighting, shift)),
    ]  # fmt: skip
