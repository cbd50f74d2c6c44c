"""Circles through certified point sets beside their solutions in sixty digits."""

import json
from pathlib import Path

import numpy as np

from labrig.vision.circle import fit_circle
from tests.benchmarks.table import print_rows

CIRCLES = Path(__file__).parents[3] / "shared" / "data" / "circlefit"


def print_table() -> None:
    """Print radius and largest relative difference of every set."""
    if not CIRCLES.is_dir():
        print(f"skipped: {CIRCLES} is not here")
        return
    certified = json.loads((CIRCLES / "certified.json").read_text(encoding="utf-8"))
    rows = []
    for path in sorted(CIRCLES.glob("*.csv")):
        points = np.genfromtxt(path, delimiter=",", comments="#")
        points = points[np.isfinite(points).all(axis=1)]
        circle = fit_circle(points, robust=False)
        found = np.array([*circle.centre, circle.radius])
        known = np.array(certified[path.stem]["geometric"], dtype=float)
        off = float(np.abs(found / known - 1.0).max())
        rows.append([path.stem, f"{circle.radius:.12g}", f"{off:.1e}", "1e-9"])
    print_rows(("set", "radius", "off", "limit"), rows)
