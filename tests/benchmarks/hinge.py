"""The hinge: the grid of figure 3 against equation (3), its time, and the search against brute force."""

import json
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from labrig.needle.hinge import HingeView
from labrig.needle.rotation_search import search_largest_rotation
from tests.benchmarks.table import measure, print_rows
from tests.needle.no_fit import LargestFree
from tests.needle.test_rotation_search import random_hinge

DESIGNS = 20
STEP_DEG = 0.01


def print_table() -> None:
    """Print the design command on the paper's needle, then twenty random designs."""
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
class HingeComparison:
    """A hinge of a design: the largest free angle of the grid less the searched angle, and the work."""

    difference_deg: float
    angles: int
    tried: int


def _print_brute_force() -> None:
    started = time.perf_counter()
    with ProcessPoolExecutor() as executor:
        compared = [both for pair in executor.map(_compare, range(DESIGNS)) for both in pair]
    differences = [view.difference_deg for view in compared]
    print(
        f"brute force every {STEP_DEG} degrees of the whole box, {DESIGNS} random designs, both hinges: "
        f"{sum(view.angles for view in compared)} angles, {sum(view.tried for view in compared)} tried and the others "
        f"ruled out by a bound; largest free angle less the searched angle "
        f"{min(differences):+.3f} to {max(differences):+.3f} degrees (limit 0.02 either way), "
        f"{time.perf_counter() - started:.0f} s"
    )


def _compare(number: int) -> list[HingeComparison]:
    hinge = random_hinge(number)
    return [_compare_view(view) for view in (hinge.hinge_a(), hinge.hinge_b())]


def _compare_view(view: HingeView) -> HingeComparison:
    brute = LargestFree(view, STEP_DEG)
    difference_deg = brute.angle_deg() - search_largest_rotation(view).rotation_deg
    return HingeComparison(difference_deg, brute.angles, brute.tried)
