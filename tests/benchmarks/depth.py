"""What one picture tells of a needle's depth: how often it alarms rightly and wrongly, and how much it narrows.

`python -m tests.benchmarks depth`; the number of pictures in each row is `LABRIG_BENCHMARK_DEPTHS`, 20 unless set. The
needles are those of the simulated rig, 60 to 112 mm long with up to six arcs, and wander out of the plane as the row
says; the map of the plane is the rig's own, as calibrated. What is told is the wandering that the interval is made
with. The constants of `labrig.vision.depth` were found with the seeds 100 to 339. Each row stands twice: with shafts
measured in rendered pictures, and with those that an insertion without pictures sees, whose errors are in
`constants.json`.
"""

import math
import os
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from multiprocessing import get_context
from typing import Any

import cv2
import numpy as np

from labrig.errors import MeasurementRefusedError
from labrig.runner.virtual_sight import draw_shaft, locate_points
from labrig.simulation.world import World
from labrig.steering.out_of_plane import OutOfPlaneSettings, covary_out_of_plane
from labrig.steering.torsion import RolledStretch, TorsionalLag
from labrig.vision.depth import Depth, measure_depth
from labrig.vision.out_of_plane import Perspective
from labrig.vision.shaft_tip import ShaftTip, measure_shaft_tip
from tests.benchmarks.table import print_rows
from tests.benchmarks.virtual import load_plane, read_simulated_rig

PICTURES = int(os.environ.get("LABRIG_BENCHMARK_DEPTHS", "20"))
FIRST_SEED = 5000
RADIUS_MM, DIAMETER_MM, SHEATH_MM = 27.7, 1.2, 2.0
LENGTHS_MM, ARCS_MM = (60.0, 112.0), (12.0, 22.0, 24.0, 24.0, 20.0, 20.0)
FAR_MM = 3.0
# Wandering out of the plane in the world and as told [deg / mm^0.5], and slip [share].
ROWS = (
    (0.0, 0.05, 0.0),
    (0.05, 0.05, 0.0),
    (0.2, 0.2, 0.0),
    (0.4, 0.4, 0.0),
    (0.4, 0.4, 0.01),
    (0.4, 0.05, 0.0),
    (0.8, 0.05, 0.0),
)


@dataclass(frozen=True)
class Outcome:
    """A picture: the true depth of the needle's end, its spread as told [mm], and what was found, None if nothing."""

    true_mm: float
    told_mm: float
    found: Depth | None


def print_table() -> None:
    """Print two rows for each world."""
    cv2.setNumThreads(1)
    heads = (
        "shafts", "wanders", "told", "slip", "pictures", "depth told", "alarms", f"alarms beyond {FAR_MM:g} mm",
        "told sd mm", "error rms mm", "sd mm", "in 95 %",
    )  # fmt: skip
    with ProcessPoolExecutor(os.cpu_count(), get_context("fork")) as pool:
        rows = []
        for row in ROWS:
            for name, drawn in (("in pictures", False), ("drawn", True)):
                seeds = range(FIRST_SEED, FIRST_SEED + PICTURES)
                outcomes = list(pool.map(partial(_measure, row, drawn), seeds, chunksize=5))
                rows.append([name, *(f"{value:g}" for value in row), *_summarise(outcomes)])
    print_rows(heads, rows)
    print("wanted: where what is told is true, at most 1 alarm in 100 and 93 to 97 % in the interval")


def _measure(row: tuple[float, float, float], drawn: bool, seed: int) -> Outcome:
    """Draw a needle and measure its depth, in a picture or by the shaft that such a picture would show."""
    wanders_deg, told_deg, slip = row
    world, length_mm = _insert(seed, wanders_deg, slip)
    true_mm = world.tip_mm()[0]
    at_mm = np.linspace(0.0, length_mm, round(length_mm / 2))
    told = OutOfPlaneSettings(
        math.radians(told_deg), 0.1, math.radians(0.1), 0.005, TorsionalLag(per_mm_sd_rad=0.0)
    )
    covariance = covary_out_of_plane([RolledStretch(length_mm, 0.0, 0)], RADIUS_MM, told, at_mm)
    told_mm = math.sqrt(covariance[-1, -1])
    perspective = Perspective.of(load_plane())
    assert perspective is not None
    end = _draw_shaft(world, seed) if drawn else _measure_shaft(world)
    if end is None:
        return Outcome(true_mm, told_mm, None)
    return Outcome(true_mm, told_mm, measure_depth(end, perspective, length_mm, at_mm, covariance))


def _draw_shaft(world: World, seed: int) -> ShaftTip:
    truth: Any = world.truth()
    seen = locate_points(np.array(truth["path_mm"]), world.description.lens, load_plane())
    return draw_shaft(seen, load_plane(), DIAMETER_MM, math.inf, np.random.default_rng([seed, 10]))


def _measure_shaft(world: World) -> ShaftTip | None:
    """Return the shaft in a picture; None if it is not found."""
    try:
        return measure_shaft_tip(world.picture(), load_plane(), DIAMETER_MM, SHEATH_MM)
    except MeasurementRefusedError:
        return None


def _insert(seed: int, wanders_deg: float, slip: float) -> tuple[World, float]:
    """Return a world with a needle in it, and the length inserted; the bevel turns back and forth."""
    described = read_simulated_rig().world
    assert described is not None
    changes = {"out_of_plane_deg_per_root_mm": wanders_deg, "slip_sd_fraction": slip}
    disturbances = described.disturbances.model_copy(update=changes)
    world = World(described.model_copy(update={"disturbances": disturbances}), seed)
    world.mount_needle("N1")
    world.place_phantom("phantom", 13.0, [])
    random, linear_mm = np.random.default_rng([seed, 9]), described.sheath_tip_at_origin_linear_mm
    world.advance(0.0, 0.0, linear_mm)
    length_mm = float(random.uniform(*LENGTHS_MM))
    ends_mm = np.minimum(np.cumsum(ARCS_MM * random.uniform(0.8, 1.2, len(ARCS_MM))), length_mm)
    first = int(random.integers(2))
    for number, end_mm in enumerate((*ends_mm, length_mm)):
        world.advance(float(end_mm), math.pi * ((number + first) % 2), linear_mm)
    return world, length_mm


def _summarise(outcomes: list[Outcome]) -> list[object]:
    found = [(outcome, outcome.found) for outcome in outcomes if outcome.found is not None]
    alarms = sum(depth.contradicts for _, depth in found)
    far = [depth.contradicts for outcome, depth in found if abs(outcome.true_mm) > FAR_MM]
    errors_mm = np.array([depth.x_mm - outcome.true_mm for outcome, depth in found])
    sds_mm = np.array([depth.sd_mm for _, depth in found])
    told_mm = np.array([outcome.told_mm for outcome, _ in found])
    return [
        len(outcomes), len(found), alarms, f"{sum(far)} of {len(far)}", f"{np.median(told_mm):.2f}",
        f"{math.sqrt(float(np.mean(errors_mm**2))):.2f}", f"{np.median(sds_mm):.2f}",
        f"{np.mean(np.abs(errors_mm) <= 1.96 * sds_mm):.0%}",
    ]  # fmt: skip
