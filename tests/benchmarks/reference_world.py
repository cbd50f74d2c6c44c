"""How large the disturbances of the reference world are: with them the paper's policy does as the paper reports.

The paper reports 2 mm over a reach of 100 mm, and occasional failures, which it ascribes to replanning only every 20
mm (section V-C). It does not say whether failures are in the 2 mm. In the world they may end the path tens of
millimetres before the target, and few of them make most of the mean. So the table has both means, in the plane, which
is all that the paper's camera saw: that of all insertions, and that of those which did not end blocked. The wandering
of heading and curvature of `rig-simulated.yaml` is scaled until 2 mm lie between the two. The seeds are used for
nothing else; LABRIG_BENCHMARK_WORLDS sets their number.
"""

import math
import os
import statistics
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial

from scipy.stats import binomtest

from labrig.simulation.description import WorldDescription
from tests.benchmarks.blind_insertion import InsertionEnd, insert
from tests.benchmarks.table import print_rows
from tests.benchmarks.worlds import draw_world, read_world

SEEDS = range(200_000, 200_000 + int(os.environ.get("LABRIG_BENCHMARK_WORLDS", "200")))
SCALES = (1.0, 1.25, 1.5)
REPORTED_MM = 2.0
_HEADS = (
    "scale", "heading deg / root mm", "curvature", "mean mm", "SE", "not blocked: mean mm", "SE", "median",
    "within 2 mm", "95 %", "missed", "blocked",
)  # fmt: skip


def print_table() -> None:
    """Print what the paper's policy does at each scale."""
    rows = []
    for scale in SCALES:
        with ProcessPoolExecutor() as executor:
            ends = list(executor.map(partial(_insert, scale=scale), SEEDS, chunksize=4))
        rows.append(_row(scale, ends))
        print_rows(_HEADS, rows[-1:])
        print(flush=True)
    used = read_world("reference").disturbances.heading_deg_per_root_mm
    today = read_world("simulated").disturbances.heading_deg_per_root_mm
    print(f"the paper reports {REPORTED_MM:g} mm; rig-reference.yaml has the scale {used / today:.2f}")


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
    errors_mm = [end.in_plane_mm for end in ends]
    arrived_mm = [end.in_plane_mm for end in ends if end.stop != "blocked"]
    near = sum(error_mm <= REPORTED_MM for error_mm in errors_mm)
    limits = binomtest(near, len(ends)).proportion_ci(0.95, "wilson")
    return [
        f"{scale:g}", f"{disturbances.heading_deg_per_root_mm:g}", f"{disturbances.curvature_fraction:g}",
        *_average(errors_mm), *_average(arrived_mm), f"{statistics.median(errors_mm):.2f}",
        f"{near} of {len(ends)}", f"{100 * limits.low:.0f} to {100 * limits.high:.0f} %",
        sum(end.stop == "target_missed" for end in ends), len(ends) - len(arrived_mm),
    ]  # fmt: skip


def _average(errors_mm: Sequence[float]) -> tuple[str, str]:
    """Return a mean and its standard error."""
    error_mm = statistics.stdev(errors_mm) / math.sqrt(len(errors_mm))
    return f"{statistics.mean(errors_mm):.2f}", f"{error_mm:.2f}"
