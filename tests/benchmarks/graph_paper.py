"""Drawn sheets of graph paper with known truth: how many plane maps are right, refused, or accepted with a wrong scale.

The sheets come from `tests.vision.paper_renderer`, which shares nothing with the program: five rulings, four inks, 1.6
to 20 px/mm, tilt to 20 and roll to 40 degrees, blur, noise, uneven light, and in two of five an edge of the paper. The
camera's lens is given as calibrated, exactly. A second table has a pen grid on the sheets: on every second to tenth
line, exactly or with a hand's jitter, half of them where the printed lines are 2.5 to 4 px/mm.
"""

import os
import statistics
import time
from collections import Counter
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from labrig.errors import CalibrationRefusedError
from labrig.vision.intrinsics import Intrinsics
from labrig.vision.plane import PlaneMap
from labrig.vision.plane_calibration import calibrate_plane
from tests.benchmarks.table import print_rows
from tests.vision.paper_renderer import RULINGS, Camera, Sheet, draw_random_pen, draw_random_sheet, draw_sheet

SHEETS = int(os.environ.get("LABRIG_BENCHMARK_SHEETS", "300"))
FIRST_SEED, FIRST_PENNED_SEED = 90_000, 520_000
Bands = tuple[tuple[float, float], ...]
# Every second sheet is of the last band.
BANDS = ((1.6, 4.0), (4.0, 6.0), (6.0, 20.0))
BAND_OF = (2, 0, 2, 1)
# Half of the sheets with a pen grid are of the first band: there the printed lines are hardly seen.
PEN_BANDS = ((2.5, 4.0), (4.0, 6.0), (6.0, 20.0))
PEN_BAND_OF = (0, 1, 0, 2)
# An accepted map is wrong if a length in any direction is off by more than this.
LARGEST_ERROR = 0.002
# The frame needs lines along the insertion; how far a sheet is turned is no matter of its scale.
TURNED = "the lines are turned by"
RIGHT, REFUSED, WRONG = "right", "refused", "wrong"


@dataclass(frozen=True)
class Outcome:
    """What came of a sheet: verdict, largest relative error of a length, time, and the first reason of a refusal."""

    sheet: Sheet
    band: int
    verdict: str
    error: float | None
    time_s: float
    reason: str


def choose_sheet(number: int, first_seed: int) -> tuple[int, Sheet]:
    """Return the band and the sheet of a number: bands and rulings take turns, edges are drawn."""
    seed = first_seed + number
    band = BAND_OF[number % len(BAND_OF)]
    ruling = list(RULINGS)[(number // len(BAND_OF)) % len(RULINGS)]
    with_edge = np.random.default_rng((seed, 1)).random() < 0.4
    return band, draw_random_sheet(seed, BANDS[band], ruling, bool(with_edge))


def choose_penned_sheet(number: int, first_seed: int) -> tuple[int, Sheet]:
    """Return the band and a sheet with a pen grid: bands and rulings take turns."""
    seed = first_seed + number
    band = PEN_BAND_OF[number % len(PEN_BAND_OF)]
    ruling = list(RULINGS)[(number // len(PEN_BAND_OF)) % len(RULINGS)]
    return band, draw_random_pen(seed, draw_random_sheet(seed, PEN_BANDS[band], ruling, with_edge=False))


def make_lens(camera: Camera) -> Intrinsics:
    """Return the camera's lens as a calibration states it."""
    sigma: dict[str, float | None] = dict.fromkeys(("fx", "fy", "cx", "cy"), 0.5)
    focal, (u, v) = camera.focal_px, camera.centre_px
    distortion = (camera.k1, camera.k2, 0.0, 0.0, 0.0)
    return Intrinsics(camera.size, focal, focal, u, v, distortion, sigma, 0.1, 0.1, (), True, ())


def measure_sheet(band: int, sheet: Sheet, picture: NDArray[np.uint8]) -> Outcome:
    """Calibrate the plane from a sheet's picture, and compare lengths with the truth."""
    lens = make_lens(sheet.camera)
    started = time.perf_counter()
    try:
        plane = calibrate_plane(picture, lens, sheet.pitch_mm, (640.0, 360.0), "right")
    except CalibrationRefusedError as refusal:
        return Outcome(sheet, band, REFUSED, None, time.perf_counter() - started, refusal.message)
    time_s = time.perf_counter() - started
    error = measure_error(plane, sheet)
    reasons = [reason for reason in plane.reasons if not reason.startswith(TURNED)]
    if reasons:
        return Outcome(sheet, band, REFUSED, error, time_s, reasons[0])
    return Outcome(sheet, band, RIGHT if error <= LARGEST_ERROR else WRONG, error, time_s, "")


def measure_error(plane: PlaneMap, sheet: Sheet) -> float:
    """Return the largest relative error of a length in any direction, over the paper in the picture."""
    width, height = sheet.camera.size
    grid = np.meshgrid(np.linspace(0, width - 1, 33), np.linspace(0, height - 1, 19))
    px = np.column_stack([axis.ravel() for axis in grid])
    px = px[sheet.is_inside(sheet.to_mm(px), 0.0)]
    true = sheet.to_mm(px)
    design = np.column_stack((true, np.ones(len(true))))
    affine = np.linalg.lstsq(design, plane.to_mm(px), rcond=None)[0]
    return float(np.abs(np.linalg.svd(affine[:2], compute_uv=False) - 1.0).max())


def print_table() -> None:
    """Print right, refused and wrong by scale and by ruling, the time, and why sheets were refused.

    First sheets as they are printed, then sheets on which a pen has drawn a grid over a part of the lines.
    """
    cv2.setNumThreads(1)
    for choose, first_seed, bands in (
        (choose_sheet, FIRST_SEED, BANDS),
        (choose_penned_sheet, FIRST_PENNED_SEED, PEN_BANDS),
    ):
        outcomes = []
        for number in range(SHEETS):
            band, sheet = choose(number, first_seed)
            outcomes.append(measure_sheet(band, sheet, draw_sheet(sheet)))
        print_outcomes(outcomes, bands)
        print(
            f"seeds {first_seed} to {first_seed + SHEETS - 1}; wrong: a length off by more than {LARGEST_ERROR:.1%}\n"
        )


def print_outcomes(outcomes: list[Outcome], bands: Bands) -> None:
    """Print the tables of a list of outcomes."""
    heads = (
        "sheets",
        RIGHT,
        REFUSED,
        WRONG,
        "accepted",
        "median error",
        "largest error",
        "median s",
        "worst s",
    )
    rows = [
        [f"{low:g}-{high:g} px/mm", *_summarise([found for found in outcomes if found.band == band])]
        for band, (low, high) in enumerate(bands)
    ]
    rows += [
        [f"{ruling} mm", *_summarise([found for found in outcomes if found.sheet.ruling == ruling])]
        for ruling in RULINGS
    ]
    print_rows(("", *heads), [*rows, ["all", *_summarise(outcomes)]])
    for band, (low, high) in enumerate(bands):
        reasons = Counter(
            "".join(letter for letter in found.reason if not letter.isdigit())[:90]
            for found in outcomes
            if found.band == band and found.verdict == REFUSED
        )
        for reason, count in reasons.most_common():
            print(f"{low:g}-{high:g} px/mm, {count} refused: {reason}")


def _summarise(outcomes: list[Outcome]) -> list[object]:
    counts = Counter(found.verdict for found in outcomes)
    errors = [found.error for found in outcomes if found.verdict != REFUSED and found.error is not None]
    times = [found.time_s for found in outcomes]
    accepted = sum(counts[verdict] for verdict in (RIGHT, WRONG))
    return [
        len(outcomes),
        *(counts[verdict] for verdict in (RIGHT, REFUSED, WRONG)),
        f"{accepted / len(outcomes):.0%}" if outcomes else "-",
        f"{statistics.median(errors):.5%}" if errors else "-",
        f"{max(errors):.4%}" if errors else "-",
        f"{statistics.median(times):.2f}" if times else "-",
        f"{max(times):.2f}" if times else "-",
    ]
