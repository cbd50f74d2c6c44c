"""Where insertions end behind torsion: turned back and forth, the same way, as chosen, and with the lag measured.

The lag grows along the needle, to 5, 10 and 20 degrees at 100 mm. The worlds are those of the closed loop without
pictures (`worlds`) about the reference world, each with that lag. Where the lag is measured, that is done first in a
plain block of the same world, as `protocols/roll-zero.yaml` does it, with the noise of a tip and a heading that were
measured in a picture. LABRIG_BENCHMARK_WORLDS sets the number of worlds.
"""

import math
import statistics
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial

import numpy as np

from labrig.experiments.shared.torsion_bends import BENT_MM, list_arcs_mm
from labrig.protocol.sections import TorsionSteps
from labrig.simulation.description import WorldDescription
from labrig.simulation.world import World
from labrig.steering.torsion import LagError, TorsionalLag
from labrig.steering.torsion_fit import BendLengths, TorsionBend, fit_torsion
from tests.benchmarks.blind_insertion import InsertionEnd, Turning, insert
from tests.benchmarks.closed_loop import WORLDS
from tests.benchmarks.table import print_rows
from tests.benchmarks.worlds import (
    GELATIN_PERCENT,
    SPREADS,
    DrawnWorld,
    draw_world,
    read_protocol,
    read_world,
)

LAGS_DEG = {0.0: None, 5.0: 1.0, 10.0: 1.5, 20.0: 3.0}
"""Lag at 100 mm, and the largest mean error with the lag measured [mm]."""
WAYS: tuple[tuple[Turning, bool], ...] = (
    ("back_and_forth", False),
    ("same_way", False),
    ("compensated", False),
    ("compensated", True),
)
"""How the bevel is turned, and whether the lag was measured."""
SEEDS = range(10_000, 10_000 + WORLDS)
TIP_SD_MM, HEADING_SD_RAD = 0.015, math.radians(0.05)
"""With these the residuals of the fit are those of simulated pictures, 0.01 to 0.02 mm rms."""


def print_table() -> None:
    """Print the error in space and its part out of the plane, for each lag and way of turning."""
    rows = [
        _row(lag_deg, limit_mm, turning, measured=measured)
        for lag_deg, limit_mm in LAGS_DEG.items()
        for turning, measured in WAYS
    ]
    heads = (
        "lag at 100 mm",
        "turning",
        "lag measured",
        "mean mm",
        "95 %",
        "worst",
        "mean |x|",
        "limit",
        "touched",
    )
    print_rows(heads, rows)
    print_rows(
        ("lag at 100 mm", "measured: mean", "SD of it", "told SD, mean"),
        [_measure_all(lag) for lag in LAGS_DEG],
    )


def _row(lag_deg: float, limit_mm: float | None, turning: Turning, *, measured: bool) -> list[object]:
    with ProcessPoolExecutor() as executor:
        ends = list(executor.map(partial(_insert, lag_deg, turning, measured), SEEDS, chunksize=4))
    errors_mm = sorted(end.error_mm for end in ends)
    return [
        f"{lag_deg:g} deg", turning, "yes" if measured else "no", f"{statistics.mean(errors_mm):.2f}",
        f"{np.percentile(errors_mm, 95):.2f}", f"{errors_mm[-1]:.2f}",
        f"{statistics.mean(end.out_of_plane_mm for end in ends):.2f}",
        f"{limit_mm:g}" if measured and limit_mm is not None else "-",
        sum(end.clearance_mm < 0 for end in ends),
    ]  # fmt: skip


def _insert(lag_deg: float, turning: Turning, measured: bool, seed: int) -> InsertionEnd:
    """Carry out the insertion of a seed."""
    drawn = _draw(lag_deg, seed)
    lag = _measure(drawn.world.description, seed)[0] if measured else TorsionalLag()
    return insert(replace(drawn, measured_lag=lag), "default", turning)


def _draw(lag_deg: float, seed: int) -> DrawnWorld:
    """Return the world of a seed with this lag at 100 mm."""
    world = read_world("reference")
    needle = world.needle.model_copy(
        update={"torsion_lag_deg": 0.0, "torsion_lag_deg_per_mm": lag_deg / 100.0}
    )
    return draw_world(world.model_copy(update={"needle": needle}), seed, replace(SPREADS, torsion=0.0))


def _measure_all(lag_deg: float) -> list[object]:
    """Return the mean of the measured lag at 100 mm, its standard deviation, and what the fits say that is."""
    found = [_measure(_draw(lag_deg, seed).world.description, seed) for seed in SEEDS[:50]]
    lags_deg = [math.degrees(lag.lag_rad + 100.0 * lag.lag_rad_per_mm) for lag, _ in found]
    told_deg = statistics.mean(math.degrees(sd_rad) for _, sd_rad in found)
    return [
        f"{lag_deg:g} deg", f"{statistics.mean(lags_deg):.2f}", f"{statistics.stdev(lags_deg):.2f}", f"{told_deg:.2f}"
    ]  # fmt: skip


def _measure(described: WorldDescription, seed: int) -> tuple[TorsionalLag, float]:
    """Return the lag by a measurement in a plain block, and its standard deviation [rad]."""
    steps, noise = TorsionSteps(), np.random.default_rng([seed, 7])
    lengths = BendLengths(BENT_MM, steps.further_mm, steps.backlash_mm)
    bends = [
        _probe(described, seed, TorsionBend(depth_mm, direction, 0.0, 0.0, 0.0), steps, noise)
        for depth_mm in steps.depths_mm
        for direction in (1, -1)
    ]
    fit = fit_torsion(bends, lengths, read_protocol().planner.radius_mm)
    error = LagError(fit.best_mm, fit.best_sd_rad, fit.lag_per_mm_sd_rad)
    return TorsionalLag(fit.lag_rad, fit.lag_rad_per_mm, error), fit.sd_rad


def _probe(
    described: WorldDescription,
    seed: int,
    asked: TorsionBend,
    steps: TorsionSteps,
    noise: np.random.Generator,
) -> TorsionBend:
    """Insert into a plain block as for a measurement, and return the deflections that noisy tips and headings give."""
    world, linear_mm = World(described, seed), described.sheath_tip_at_origin_linear_mm
    world.mount_needle("N1")
    world.place_specimen(f"plain block {asked.depth_mm:g} {asked.direction}", GELATIN_PERCENT)
    arcs_mm = list_arcs_mm(asked.depth_mm)
    base_rad = 0.0 if len(arcs_mm) % 2 else math.pi
    world.advance(0.0, base_rad, linear_mm)
    for to_mm in np.cumsum(arcs_mm[:-1]):
        world.advance(float(to_mm), base_rad, linear_mm)
        base_rad += math.pi
        world.advance(float(to_mm), base_rad, linear_mm)
    seen = list[tuple[float, float, float]]()
    for to_mm in (asked.depth_mm - BENT_MM, asked.depth_mm, asked.depth_mm + steps.further_mm):
        if len(seen) == 2:
            side_rad = base_rad + math.pi / 2
            world.advance(asked.depth_mm, side_rad - asked.direction * math.pi, linear_mm)
            world.advance(asked.depth_mm, side_rad, linear_mm)
            base_rad = side_rad
        world.advance(to_mm, base_rad, linear_mm)
        seen.append(_see(world, noise))
    return replace(
        asked,
        bent_from_mm=asked.depth_mm - arcs_mm[-1],
        bent_mm=_deflect_mm(*seen[:2]),
        turned_mm=_deflect_mm(*seen[1:]),
    )


def _see(world: World, noise: np.random.Generator) -> tuple[float, float, float]:
    """Return y and z of the tip [mm], and its heading [rad], as measured."""
    before, end = world.centre_line_mm()[-2:]
    heading_rad = math.atan2(*(end - before))
    y_mm, z_mm = end + noise.normal(0.0, TIP_SD_MM, 2)
    return float(y_mm), float(z_mm), heading_rad + float(noise.normal(0.0, HEADING_SD_RAD))


def _deflect_mm(start: Sequence[float], end: Sequence[float]) -> float:
    y_mm, z_mm, heading_rad = end[0] - start[0], end[1] - start[1], start[2]
    return y_mm * math.cos(heading_rad) - z_mm * math.sin(heading_rad)
