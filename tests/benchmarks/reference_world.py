"""How large the disturbances of the reference world are: with them the paper's policy does as the paper reports.

The paper reports 2 mm over a reach of 100 mm, and occasional failures, which it ascribes to replanning only every 20
mm (section V-C). The wandering of heading and curvature of `rig-simulated.yaml` is scaled until the paper's planner,
filter and policy have a mean error of 2 mm in the plane, which is all that its camera saw; those that fail are in the
mean. The seeds are used for nothing else.
"""

import math
import statistics
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from itertools import pairwise

import numpy as np

from labrig.simulation.description import WorldDescription
from tests.benchmarks.blind_insertion import InsertionEnd, insert
from tests.benchmarks.table import print_rows
from tests.benchmarks.worlds import draw_world, read_world

SEEDS = range(100_000, 100_060)
SCALES = (1.0, 1.25, 1.5)
REPORTED_MM = 2.0


def print_table() -> None:
    """Print what the paper's policy does at each scale, and the scale at which it does as reported."""
    with ProcessPoolExecutor() as executor:
        done = [list(executor.map(partial(_insert, scale=scale), SEEDS, chunksize=4)) for scale in SCALES]
    heads = (
        "scale", "heading deg / root mm", "curvature", "mean mm", "SE", "median", "within 2 mm", "path ends early",
    )  # fmt: skip
    print_rows(heads, [_row(scale, ends) for scale, ends in zip(SCALES, done, strict=True)])
    used = read_world("reference").disturbances.heading_deg_per_root_mm
    today = read_world("simulated").disturbances.heading_deg_per_root_mm
    fitted = _find_scale([_mean_mm(ends) for ends in done])
    where = "at none of these scales" if fitted is None else f"at the scale {fitted:.2f}"
    print(f"mean error {REPORTED_MM:g} mm {where}; rig-reference.yaml has {used / today:.2f}")


def _find_scale(means_mm: Sequence[float]) -> float | None:
    """Return the smallest scale with the reported mean, interpolated; None if it is not between two of them."""
    for (low, low_mm), (high, high_mm) in pairwise(zip(SCALES, means_mm, strict=True)):
        if low_mm <= REPORTED_MM <= high_mm:
            return float(np.interp(REPORTED_MM, (low_mm, high_mm), (low, high)))
    return None


def scale_disturbances(scale: float) -> WorldDescription:
    """Return the reference world with the wandering of rig-simulated.yaml times a scale."""
    world, wandering = read_world("reference"), read_world("simulated").disturbances
    disturbances = world.disturbances.model_copy(
        update={
            "heading_deg_per_root_mm": scale * wandering.heading_deg_per_root_mm,
            "curvature_fraction": scale * wandering.curvature_fraction,
        }
    )
    return world.model_copy(update={"disturbances": disturbances})


def _insert(seed: int, scale: float) -> InsertionEnd:
    return insert(draw_world(scale_disturbances(scale), seed), "paper")


def _row(scale: float, ends: Sequence[InsertionEnd]) -> list[object]:
    disturbances = scale_disturbances(scale).disturbances
    errors = [end.in_plane_mm for end in ends]
    return [
        f"{scale:g}", f"{disturbances.heading_deg_per_root_mm:g}", f"{disturbances.curvature_fraction:g}",
        f"{_mean_mm(ends):.2f}", f"{statistics.stdev(errors) / math.sqrt(len(errors)):.2f}",
        f"{statistics.median(errors):.2f}",
        f"{100 * statistics.mean(error <= REPORTED_MM for error in errors):.0f} %",
        sum(end.stop not in {"target_reached", "target_missed"} for end in ends),
    ]  # fmt: skip


def _mean_mm(ends: Sequence[InsertionEnd]) -> float:
    return statistics.mean(end.in_plane_mm for end in ends)
