"""Drawn sheets of graph paper with known truth: how many plane maps are right, refused, or accepted and wrong.

`ruled-paper` prints three hand-held photographs. The drawn sheets come from `tests.vision.renderer`, which shares
nothing with the program: the six rulings that shops sell, four inks, 3 to 20 px/mm, tilt and roll to 25 degrees, blur,
noise, light from one side, half of them on a bench that shows beside them. The camera's lens is given as calibrated,
exactly, the scale to 15 %.
"""

import time
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pandas as pd

from labrig.errors import CalibrationRefusedError
from labrig.vision.calibrate_plane import calibrate_plane
from labrig.vision.picture import read_picture
from tests.benchmarks.table import multiply, print_rows
from tests.vision.renderer import INKS, PAPERS, Camera, Photo, Sheet

SHEETS = multiply(30)
FIRST_SEED = 700_000
BANDS = ((3.0, 4.0), (4.0, 6.0), (6.0, 20.0))
SHOP_RULINGS = ("1", "1/5", "1/10", "1/5/10", "2", "5")
SCALE_ERROR = 0.15
# An accepted map is wrong if a length in any direction is off by more than this.
LARGEST_ERROR = 0.002
RIGHT, REFUSED, WRONG = "right", "refused", "wrong"
PHOTOGRAPHS = Path(__file__).parents[3] / "shared" / "data" / "ruled_paper"
FLAT = {"ecg00026.jpg": "flat", "ecg00031.jpg": "not flat", "ecg00040.jpg": "flat"}
PHOTOGRAPH_PX_PER_MM = 4.4  # five millimetres are about 22 pixels in all three


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


def measure_sheet(number: int) -> dict[str, float | str | None]:
    """Calibrate the plane from the picture of a sheet, compare lengths with the truth, and return a row of the table.

    Bands, rulings and benches take turns. `error` is the largest relative error of a length.
    """
    band, ruling = number % len(BANDS), SHOP_RULINGS[(number // len(BANDS)) % len(SHOP_RULINGS)]
    on_bench = (number // (len(BANDS) * len(SHOP_RULINGS))) % 2 == 0
    sheet = draw_shop_sheet(FIRST_SEED + number, BANDS[band], ruling, on_bench)
    lens, pitch_mm, picture = sheet.camera.intrinsics, sheet.pitch_mm, sheet.draw()
    off = np.random.default_rng((sheet.photo.seed, 7)).uniform(-SCALE_ERROR, SCALE_ERROR)
    px_per_mm = float(sheet.camera.px_per_mm * (1.0 + off))
    error, reason, started = None, "", time.process_time()
    try:
        plane = calibrate_plane(picture, lens, pitch_mm, (640.0, 360.0), "right", px_per_mm=px_per_mm)
    except CalibrationRefusedError as refusal:
        verdict, reason, time_s = REFUSED, refusal.message, time.process_time() - started
    else:
        time_s, error = time.process_time() - started, sheet.length_error(plane)
        verdict = RIGHT if error <= LARGEST_ERROR else WRONG
        if not plane.accepted:
            verdict, reason = REFUSED, plane.reasons[0]
    scale = "{:g}-{:g} px/mm".format(*BANDS[band])
    reason = "".join(letter for letter in reason if not letter.isdigit())[:90]
    return {
        "scale": scale, "ruling": f"{ruling} mm", "verdict": verdict, "error": error, "s": time_s,
        "reason": reason,
    }  # fmt: skip


def print_table() -> None:
    """Print right, refused and wrong by scale and by ruling, the processor's time, and why sheets were refused."""
    cv2.setNumThreads(1)
    sheets = pd.DataFrame(map(measure_sheet, range(SHEETS)))
    heads = ("sheets", RIGHT, REFUSED, WRONG, "accepted", "median error", "largest", "median s", "worst s")
    groups = [group for by in ("scale", "ruling") for group in sheets.groupby(by, sort=False)]
    print_rows(("", *heads), [[name, *_summarise(group)] for name, group in (*groups, ("all", sheets))])
    for scale, own in sheets[sheets["verdict"] == REFUSED].groupby("scale", sort=False):
        for reason, count in own["reason"].value_counts().items():
            print(f"{scale}, {count} refused: {reason}")
    print(f"seeds from {FIRST_SEED}; wrong: a length off by more than {LARGEST_ERROR:.1%}\n")


def _summarise(sheets: pd.DataFrame) -> list[object]:
    counts = sheets["verdict"].value_counts().reindex((RIGHT, REFUSED, WRONG), fill_value=0)
    errors, times = sheets["error"][sheets["verdict"] != REFUSED].astype(float), sheets["s"]
    figures = (f"{errors.median():.5%}", f"{errors.max():.4%}", f"{times.median():.2f}", f"{times.max():.2f}")
    return [len(sheets), *counts, f"{1.0 - counts[REFUSED] / len(sheets):.0%}", *figures]


def print_photographs() -> None:
    """Print per photographed sheet the points, the error of held-out points, and whether it is flat."""
    if not PHOTOGRAPHS.is_dir():
        print(f"skipped: {PHOTOGRAPHS} is not here")
        return
    rows = []
    for name, wanted in FLAT.items():
        picture = read_picture(PHOTOGRAPHS / name)
        plane = calibrate_plane(picture, None, 1.0, (600.0, 250.0), "right", px_per_mm=PHOTOGRAPH_PX_PER_MM)
        verdict = "not flat" if any("not flat" in reason for reason in plane.reasons) else "flat"
        rows.append(
            [name, plane.points, f"{plane.holdout_rms_mm:.3f}", f"{plane.flatness_mm:.2f}", verdict, wanted]
        )
    print_rows(("sheet", "points", "left out: plane", "unevenness mm", "verdict", "wanted"), rows)
