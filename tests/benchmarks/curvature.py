"""Radii in rendered pictures of a known arc, with cameras calibrated from rendered corners and paper.

`python -m tests.benchmarks curvature`; the number of pictures is `LABRIG_BENCHMARK_PICTURES`, 500 unless set. The
renderer is `tests/vision/rendering.py`, which shares no code with the measurement. Each calibration and its ten
pictures are drawn from a seed of their own, so the numbers are the same for any number of processes.
"""

import multiprocessing
import os
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial

import cv2
import numpy as np
from numpy.typing import NDArray

from labrig.vision.calibrate_lens import board_points_mm, calibrate_intrinsics
from labrig.vision.calibrate_plane import calibrate_plane
from labrig.vision.circle import fit_circle
from labrig.vision.curvature import CurvatureMeasurement, CurvatureSettings, measure_curvature
from labrig.vision.intrinsics import Intrinsics
from labrig.vision.plane import PlaneMap
from tests.benchmarks.table import print_rows
from tests.vision.rendering import RenderedBench, RenderedGel, RenderedLens, RenderedNeedle

FloatArray = NDArray[np.float64]

RADIUS_MM = 28.0
PICTURES = int(os.environ.get("LABRIG_BENCHMARK_PICTURES", "500"))
PICTURES_A_CALIBRATION = 10
CORNER_NOISE_PX = 0.1
PAPER_NOISE = 3.0
SPEED_REPEATS = 30


def print_table() -> None:
    """Print bias, worst error and coverage over pictures, efficiency on clean arcs, and time of a 1080p frame."""
    measured = _measure_all()
    accepted = [picture for picture in measured if picture.accepted and picture.radius_mm is not None]
    errors = np.array([picture.radius_mm or np.nan for picture in accepted]) - RADIUS_MM
    held = [
        picture.radius_ci95_mm is not None
        and picture.radius_ci95_mm[0] <= RADIUS_MM <= picture.radius_ci95_mm[1]
        for picture in accepted
    ]
    parts = np.mean(
        [[picture.sigma_radius_mm or 0.0, picture.sigma_calibration_mm or 0.0] for picture in accepted],
        axis=0,
    )
    rows: list[list[object]] = [
        [f"pictures measured, of {len(measured)}", len(accepted), len(measured)],
        ["bias of the radius, %", f"{100.0 * errors.mean() / RADIUS_MM:+.4f}", "0.03"],
        ["worst error, mm", f"{np.abs(errors).max():.4f}", "0.1"],
        ["95 % intervals that hold the truth, %", f"{100.0 * np.mean(held):.1f}", "92 to 98"],
        ["observed sd, mm", f"{errors.std():.4f}", "-"],
        ["stated sd, mm (of which calibration)", f"{parts[0]:.4f} ({parts[1]:.4f})", "-"],
        ["efficiency on clean arcs", f"{_measure_efficiency():.3f}", "0.8"],
        ["shaft and circle of a 1080p frame, ms", f"{_measure_time_ms():.1f}", "20"],
    ]
    print_rows(("figure", "measured", "limit"), rows)


def _measure_all() -> list[CurvatureMeasurement]:
    """Return the measurements of all pictures, on all cores."""
    firsts = range(0, PICTURES, PICTURES_A_CALIBRATION)
    bench = RenderedBench(RenderedLens())
    cv2.setNumThreads(1)  # a process per core; OpenCV's threads do not survive the fork either
    with ProcessPoolExecutor(os.cpu_count(), multiprocessing.get_context("fork")) as pool:
        return [one for batch in pool.map(partial(_measure_batch, bench), firsts) for one in batch]


def _measure_batch(bench: RenderedBench, first: int) -> list[CurvatureMeasurement]:
    """Return the measurements of the pictures of a calibration."""
    random = np.random.default_rng(first)
    plane = _calibrate_plane(bench, _calibrate_lens(bench.lens, random), random)
    count = min(PICTURES_A_CALIBRATION, PICTURES - first)
    return [_measure(bench, plane, first + number, random) for number in range(count)]


def _measure(
    bench: RenderedBench, plane: PlaneMap, seed: int, random: np.random.Generator
) -> CurvatureMeasurement:
    needle = RenderedNeedle(RADIUS_MM, sheath_tip_mm=(random.uniform(-2.0, 6.0), random.uniform(-1.0, 3.0)))
    return measure_curvature(bench.picture(needle, RenderedGel(), seed), plane, CurvatureSettings())


def _calibrate_lens(lens: RenderedLens, random: np.random.Generator) -> Intrinsics:
    """Return the camera as calibrated from corners with noise."""
    board = board_points_mm(9, 6, 6.0)
    poses = (
        (0, 0, 0, 0), (35, 0, -14, 6), (-35, 0, 14, -6), (0, 35, -14, -6), (0, -35, 14, 6), (25, 25, 14, -6),
        (-25, 25, -14, 6), (30, -30, 0, 0), (-30, -30, 8, 5), (20, 0, -8, -5), (0, 20, 20, 8), (0, -20, -20, -8),
    )  # fmt: skip
    boards, views = [], []
    for tilt, turn, y, z in poses:
        first = cv2.Rodrigues(np.deg2rad(np.array([tilt, turn, 5.0])))[0]
        flat = np.column_stack((board - board.mean(axis=0), np.zeros(len(board))))
        corners = flat @ first.T + (y, z, 0.95 * lens.distance_mm)
        px = cv2.projectPoints(corners, np.zeros(3), np.zeros(3), lens.matrix, lens.distortion)[0][:, 0]
        px = px + random.normal(0.0, CORNER_NOISE_PX, px.shape)
        seen = ((px > 0.0) & (px < (lens.width - 1, lens.height - 1))).all(axis=1)
        boards.append(board[seen])
        views.append(px[seen])
    return calibrate_intrinsics(boards, views, (lens.width, lens.height))


def _calibrate_plane(bench: RenderedBench, lens: Intrinsics, random: np.random.Generator) -> PlaneMap:
    """Return the plane as calibrated from a picture of ruled paper."""
    offset = np.abs(bench.mm - np.round(bench.mm)).min(axis=2)
    lines = np.clip(0.5 + (0.05 - offset) * bench.px_per_mm, 0.0, 1.0)
    paper = cv2.GaussianBlur(210.0 * (1.0 - 0.35 * lines), (0, 0), 0.8)
    noisy = paper + random.normal(0.0, PAPER_NOISE, paper.shape)
    picture = np.clip(np.rint(noisy), 0, 255).astype(np.uint8)
    return calibrate_plane(picture, lens, 1.0, bench.lens.origin_px, "right", px_per_mm=bench.px_per_mm)


def _measure_efficiency() -> float:
    """Return the Cramer-Rao bound's variance over that of the robust fit on clean arcs of 81.85 degrees."""
    random = np.random.default_rng(7)
    turn = np.linspace(0.0, np.deg2rad(81.85), 2000)
    truth = 560.0 * np.column_stack((np.cos(turn), np.sin(turn)))
    found = [fit_circle(truth + random.normal(0.0, 0.5, truth.shape)).radius for _ in range(400)]
    directions = np.column_stack((np.cos(turn), np.sin(turn), np.ones(len(turn))))
    bound = 0.25 * np.linalg.inv(directions.T @ directions)[2, 2]
    return float(bound / np.var(found))


def _measure_time_ms() -> float:
    """Return the median time to measure a 1920x1080 picture."""
    lens = RenderedLens(1920, 1080, focal_px=2700.0, centre_px=(965.0, 532.0), origin_px=(480.0, 300.0))
    picture = RenderedBench(lens).picture(RenderedNeedle(RADIUS_MM), replace(RenderedGel(), bubbles=10), 1)
    plane, times = lens.plane_map(), []
    for _ in range(SPEED_REPEATS):
        started = time.perf_counter()
        measure_curvature(picture, plane, CurvatureSettings())
        times.append(time.perf_counter() - started)
    return float(1e3 * np.median(times))
