"""The hinge: the grid of figure 3 against equation (3), and its time."""

import json
import sys

from tests.benchmarks.table import measure, print_rows


def print_table() -> None:
    """Print the design command on the paper's needle."""
    done = measure([sys.executable, "-m", "labrig", "design", "--json"], memory=True)
    document = json.loads(done.out)
    paper, search = document["equation_3"], document["search"]
    rows = [[key, f"{search['fit'][key]:.4f}", f"{paper[key]:.4f}"] for key in ("a", "b", "c", "rmse_deg")]
    rows.append(
        ["beta_cut_deg for 30 mm", f"{search['beta_cut_deg']:.2f}", f"{document['beta_cut_deg']:.2f}"]
    )
    print_rows(("7 x 7 grid", "our contour", "equation (3)"), rows)
    print(f"labrig design: {done.wall_s:.1f} s (limit 60), {done.peak_mb:.0f} MB")
