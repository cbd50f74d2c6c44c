"""Drawn sheets of graph paper with known truth: how many plane maps are right, refused, or accepted and wrong.

The sheets come from `tests.vision.renderer`, which shares nothing with the program: the six rulings that shops
sell, four inks, 3 to 20 px/mm, tilt and roll to 25 degrees, blur, noise, light from one side, half of them on a bench
that shows beside them. The camera's lens is given as calibrated, exactly, the scale to 15 %.
"""

import statistics
import time
from collections import Counter
from dataclasses import dataclass, replace

import cv2
import numpy as np

from labrig.errors import CalibrationRefusedError
from labrig.vision.calibrate_plane import calibrate_plane
from tests.benchmarks.table import print_rows, read_count
from tests.vision.renderer import INKS, PAPERS, Camera, Photo, Picture, Sheet

SHEETS = read_count("SHEETS", 300)
FIRST_SEED = 700_000
Bands = tuple[tuple[float, float], ...]
BANDS = ((3.0, 4.0), (4.0, 6.0), (6.0, 20.0))
SHOP_RULINGS = ("1", "1/5", "1/10", "1/5/10", "2", "5")
SCALE_ERROR = 0.15
# An accepted map is wrong if a length in any direction is off by more than this.
LARGEST_ERROR = 0.002
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


def draw_shop_sheet(seed: int, band: tuple[float, float], ruling: str, on_bench: bool) -> Sheet:
    """Return a sheet as shops sell them, before a focussed camera, at random over a band of scales [px/mm].

    A sheet on a bench does not fill the picture: one to three of its edges lie in it.
    """
    random = np.random.default_rng(seed)
    focal_px = random.uniform(1000.0, 2200.0)
    centre_px = (640.0 + random.uniform(-15, 15), 360.0 + random.uniform(-15, 15))
    distortion = (random.uniform(-0.25, 0.05), random.uniform(0.0, 0.06), 0.0, 0.0, 0.0)
    low, high = band
    if ruling == "5":
        high = max(min(high, 14.0), low)
    px_per_mm = np.exp(random.uniform(np.log(low), np.log(high)))
    tilt_deg, towards_deg, roll_deg = random.uniform((0.0, 0.0, -25.0), (25.0, 360.0, 25.0)).tolist()
    camera = Camera(
        (1280, 720), focal_px, centre_px, distortion, focal_px / px_per_mm, tilt_deg, towards_deg, roll_deg
    )
    right, down, width_mm, density, blur_px, noise, uneven, fall = random.uniform(
        (0.0, 0.0, 0.1, 0.35, 0.4, 1.0, 0.0, 0.0), (10.0, 10.0, 0.25, 0.8, 0.9, 4.0, 0.9, 0.5)
    ).tolist()
    grey = bool(random.random() < 0.2)
    photo = Photo(0.4 * uneven, 0.6 * uneven, fall / 1.3, None, blur_px, 0.0, noise, grey, seed)
    ink, paper = str(random.choice(list(INKS))), str(random.choice(list(PAPERS)))
    margin_mm, behind = float(random.choice([0.0, 3.0, 10.0])), random.uniform(10.0, 100.0)
    sheet = Sheet(
        ruling, camera, photo, (right, down), ink, paper, width_mm, density, None, margin_mm, behind
    )
    sheet = replace(sheet, samples=4)
    if not on_bench:
        return sheet
    width, height = (length / 2 for length in camera.picture_size_mm())
    sides = [-10.0 * width, -10.0 * width, 10.0 * width, 10.0 * width]
    for side in random.permutation(4)[: random.integers(1, 4)]:
        half = height if side % 2 else width
        sides[side] = (-1.0 if side < 2 else 1.0) * half * random.uniform(0.5, 0.9)
    return replace(sheet, extent_mm=(sides[0], sides[1], sides[2], sides[3]))


def choose_sheet(number: int) -> tuple[int, Sheet]:
    """Return the band and the sheet of a number: bands, rulings and benches take turns."""
    band = number % len(BANDS)
    ruling = SHOP_RULINGS[(number // len(BANDS)) % len(SHOP_RULINGS)]
    on_bench = (number // (len(BANDS) * len(SHOP_RULINGS))) % 2 == 0
    return band, draw_shop_sheet(FIRST_SEED + number, BANDS[band], ruling, on_bench)


def measure_sheet(band: int, sheet: Sheet, picture: Picture) -> Outcome:
    """Calibrate the plane from a sheet's picture, and compare lengths with the truth."""
    lens, pitch_mm = sheet.camera.intrinsics, sheet.pitch_mm
    error = np.random.default_rng((sheet.photo.seed, 7)).uniform(-SCALE_ERROR, SCALE_ERROR)
    px_per_mm = float(sheet.camera.px_per_mm * (1.0 + error))
    started = time.process_time()
    try:
        plane = calibrate_plane(picture, lens, pitch_mm, (640.0, 360.0), "right", px_per_mm=px_per_mm)
    except CalibrationRefusedError as refusal:
        return Outcome(sheet, band, REFUSED, None, time.process_time() - started, refusal.message)
    time_s = time.process_time() - started
    error = sheet.length_error(plane)
    if not plane.accepted:
        return Outcome(sheet, band, REFUSED, error, time_s, plane.reasons[0])
    return Outcome(sheet, band, RIGHT if error <= LARGEST_ERROR else WRONG, error, time_s, "")


def print_table() -> None:
    """Print right, refused and wrong by scale and by ruling, the processor's time, and why sheets were refused."""
    cv2.setNumThreads(1)
    outcomes = []
    for number in range(SHEETS):
        band, sheet = choose_sheet(number)
        outcomes.append(measure_sheet(band, sheet, sheet.draw()))
    print_outcomes(outcomes, BANDS)
    print(f"seeds from {FIRST_SEED}; wrong: a length off by more than {LARGEST_ERROR:.1%}\n")


def print_outcomes(outcomes: list[Outcome], bands: Bands) -> None:
    """Print the tables of a list of outcomes."""
    heads = ("sheets", RIGHT, REFUSED, WRONG, "accepted", "median error", "largest", "median s", "worst s")
    rows = [
        [f"{low:g}-{high:g} px/mm", *_summarise([found for found in outcomes if found.band == band])]
        for band, (low, high) in enumerate(bands)
    ]
    rows += [
        [f"{ruling} mm", *_summarise([found for found in outcomes if found.sheet.ruling == ruling])]
        for ruling in SHOP_RULINGS
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
