"""Accuracy and speed of finding the tip by its template."""

import math
import statistics
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from labrig.vision.tip import locate_tip
from tests.benchmarks.table import print_rows
from tests.vision.tips import tip

PICTURES = 60
_TIMED = 200
_HEADING_ERROR_RAD = math.radians(5.0)
_NEAR_PX = 15.0


def print_table() -> None:
    """Print the error over rendered pictures, and times of a region and of a full frame."""
    template = tip(0.0, 100).template()
    random = np.random.default_rng(0)
    errors, headings, missed = [], [], 0
    for seed in range(PICTURES):
        shown = tip(float(random.uniform(-0.9, 0.9)), seed)
        near_u, near_v = (place + random.uniform(-_NEAR_PX, _NEAR_PX) for place in shown.px)
        near_rad = shown.heading_rad + random.uniform(-_HEADING_ERROR_RAD, _HEADING_ERROR_RAD)
        fix = locate_tip(
            shown.picture, template, near_px=(near_u, near_v), heading_rad=near_rad, roll_rad=0.0
        )
        if fix.tip_px is None or fix.heading_rad is None:
            missed += 1
            continue
        errors.append(np.subtract(fix.tip_px, shown.px))
        headings.append(fix.heading_rad - shown.heading_rad)
    across, down = np.sqrt(np.mean(np.square(errors), axis=0))
    shown = tip(0.3, 1)
    full = np.pad(shown.picture, ((300, 300), (640, 640)), "symmetric")[:1080, :1920].copy()
    hint: dict[str, Any] = {"heading_rad": 0.35, "roll_rad": 0.0}
    region_ms = _milliseconds(lambda: locate_tip(shown.picture, template, near_px=shown.px, **hint))
    heading_deg = math.degrees(float(np.sqrt(np.mean(np.square(headings)))))
    print_rows(
        (f"{PICTURES} pictures, noise 3, heading within 5 degrees", "measured", "limit"),
        [
            ["error along u, px rms", f"{across:.3f}", "0.1"],
            ["error along v, px rms", f"{down:.3f}", "0.1"],
            ["heading, degrees rms", f"{heading_deg:.2f}", "-"],
            ["missed", missed, "0"],
            ["region of 120 x 120 px, ms, median", region_ms, "1"],
            [
                "frame of 1920 x 1080 px, ms, median",
                _milliseconds(lambda: locate_tip(full, template, **hint)),
                "5",
            ],
        ],
    )


def _milliseconds(work: Callable[[], object]) -> str:
    times = []
    for _ in range(_TIMED):
        started = time.perf_counter()
        work()
        times.append(time.perf_counter() - started)
    return f"{1e3 * statistics.median(times):.2f}"
