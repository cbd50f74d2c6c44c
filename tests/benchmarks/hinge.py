"""The hinge: the grid of figure 3 beside equation (3), its time, and the search beside brute force."""

import json
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from labrig.needle import HingeView, largest_rotation
from tests.benchmarks.table import measure, print_rows
from tests.needle.no_fit import NoFit
from tests.needle.test_search import random_hinge

DESIGNS = 20
# 0.01 degrees over the whole box are 50 000 angles and half an hour of processor time, 15 minutes on two cores.
# Around the answer the step is that, further on ten times that.
FINE_DEG, COARSE_DEG = 0.01, 0.1
FINE_REACH_DEG = 0.5


def print_table() -> None:
    """The design command on the paper's needle, then twenty random designs."""
    _print_design()
    _print_brute_force()


def _print_design() -> None:
    with TemporaryDirectory() as folder:
        files = [f"--figure={Path(folder) / 'figure.png'}", f"--csv={Path(folder) / 'table.csv'}"]
        done = measure([sys.executable, "-m", "labrig", "design", "--json", *files])
    document = json.loads(done.out)
    paper, search = document["equation_3"], document["search"]
    rows = [[key, f"{search['fit'][key]:.4f}", f"{paper[key]:.4f}"] for key in ("a", "b", "c", "rmse_deg")]
    rows.append(
        ["beta_cut_deg for 30 mm", f"{search['beta_cut_deg']:.2f}", f"{document['beta_cut_deg']:.2f}"]
    )
    print_rows(("7 x 7 grid", "our contour", "equation (3)"), rows)
    print(f"labrig design with figure and table: {done.wall_s:.1f} s (limit 60), {done.peak_mb:.0f} MB")


@dataclass(frozen=True)
class Compared:
    """One hinge of one design: how far the brute force is from the search, and what else was free."""

    difference_deg: float
    free_beyond: int
    angles: int


def _print_brute_force() -> None:
    started = time.perf_counter()
    with ProcessPoolExecutor() as executor:
        compared = [both for pair in executor.map(_compare, range(DESIGNS)) for both in pair]
    worst = max(abs(one.difference_deg) for one in compared)
    print(
        f"brute force, {DESIGNS} random designs, both hinges, {sum(one.angles for one in compared)} angles: "
        f"worst difference {worst:.3f} degrees (limit 0.02), "
        f"{sum(one.free_beyond for one in compared)} free angles further on, "
        f"{time.perf_counter() - started:.0f} s"
    )


def _compare(number: int) -> list[Compared]:
    """Try every 0.01 degrees within 0.5 of what was searched, and every 0.1 from there to the end of the box."""
    hinge = random_hinge(number)
    return [_compare_view(view) for view in (hinge.hinge_a(), hinge.hinge_b())]


def _compare_view(view: HingeView) -> Compared:
    found_deg = largest_rotation(view).rotation_deg
    no_fit = NoFit(view)
    steps = round(FINE_REACH_DEG / FINE_DEG)
    first = max(round(found_deg / FINE_DEG) - steps, 0)
    near = FINE_DEG * np.arange(first, first + 2 * steps + 1)
    brute_deg = max(angle for angle in near if no_fit.is_free(angle))
    beyond = np.arange(near[-1] + COARSE_DEG, view.reach.rotation_deg, COARSE_DEG)
    free_beyond = sum(no_fit.is_free(angle) for angle in beyond)
    return Compared(brute_deg - found_deg, free_beyond, len(near) + len(beyond))
