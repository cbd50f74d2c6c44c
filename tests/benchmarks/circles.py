"""Circles through certified point sets beside their solutions in sixty digits."""

import numpy as np

from labrig.vision.circle import fit_circle
from tests.benchmarks.table import print_rows
from tests.vision.test_circle import CERTIFIED


def print_table() -> None:
    """Print radius and largest relative difference of every set."""
    rows = []
    for name, (points, known) in CERTIFIED.items():
        circle = fit_circle(points, robust=False)
        off = float(np.abs(np.array([*circle.centre, circle.radius]) / known - 1.0).max())
        rows.append([name, f"{circle.radius:.12g}", f"{off:.1e}", "1e-9"])
    print_rows(("set", "radius", "off", "limit"), rows)
