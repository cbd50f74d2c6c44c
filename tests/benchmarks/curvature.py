"""Radii in rendered pictures of a known arc, with cameras calibrated from rendered corners and paper.

The renderer is `tests/vision/renderer.py`, which shares no code with the measurement. Each calibration and its ten
pictures are drawn from a seed of their own, so the numbers are the same for any number of processes.
"""

import multiprocessing
import os
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from labrig.vision.calibrate_lens import calibrate_intrinsics
from labrig.vision.calibrate_plane import calibrate_plane
from labrig.vision.circle import fit_circle
from labrig.vision.curvature import CurvatureMeasurement, CurvatureSettings, measure_curvature
from labrig.vision.intrinsics import Intrinsics
from tests.benchmarks.table import multiply, print_rows
from tests.vision.renderer import Board, Camera, Gel, Needle, Photo, Sheet, turn_about

FloatArray = NDArray[np.float64]

RADIUS_MM, ORIGIN_PX = 28.0, (320.0, 200.0)
CAMERA = Camera(origin_px=ORIGIN_PX)
PICTURES = multiply(50)
PICTURES_A_CALIBRATION = 10
CORNER_NOISE_PX = 0.1
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
    cv2.setNumThreads(1)  # a process per core; OpenCV's threads do not survive the fork either
    with ProcessPoolExecutor(os.cpu_count(), multiprocessing.get_context("fork")) as pool:
        return [one for batch in pool.map(_measure_batch, firsts) for one in batch]


def _measure_batch(first: int) -> list[CurvatureMeasurement]:
    """Return the measurements of the pictures of a calibration, from a board and from ruled paper."""
    random = np.random.default_rng(first)
    lens = _calibrate_lens(CAMERA, random)
    paper = Sheet("1", CAMERA, Photo(seed=first), ink="grey", width_mm=0.1).draw()
    plane = calibrate_plane(paper, lens, 1.0, ORIGIN_PX, "right", px_per_mm=CAMERA.px_per_mm)
    count = min(PICTURES_A_CALIBRATION, PICTURES - first)
    entries = random.uniform((-1.0, -6.0), (3.0, 2.0), (count, 2)).tolist()
    return [
        measure_curvature(
            Gel(Needle(RADIUS_MM, entry_mm=(right, down), ramp_mm=3.0)).take(first + number),
            plane,
            CurvatureSettings(),
        )
        for number, (right, down) in enumerate(entries)
    ]


def _calibrate_lens(camera: Camera, random: np.random.Generator) -> Intrinsics:
    """Return the camera as calibrated from corners with noise."""
    board = Board(square_mm=6.0)
    poses = (
        (0, 0, 0, 0), (35, 0, -14, 6), (-35, 0, 14, -6), (0, 35, -14, -6), (0, -35, 14, 6), (25, 25, 14, -6),
        (-25, 25, -14, 6), (30, -30, 0, 0), (-30, -30, 8, 5), (20, 0, -8, -5), (0, 20, 20, 8), (0, -20, -20, -8),
    )  # fmt: skip
    boards, views = [], []
    for tilt, turn, right, down in poses:
        shift = (right, down, 0.95 * camera.distance_mm)
        px = board.see(camera, turn_about(*np.deg2rad((tilt, turn, 5.0))), shift, CORNER_NOISE_PX, random)
        seen = ((px > 0.0) & (px < np.array(camera.size) - 1.0)).all(axis=1)
        boards.append(board.points_mm[seen])
        views.append(px[seen])
    return calibrate_intrinsics(boards, views, camera.size)


def _measure_efficiency() -> float:
    """Return the Cramer-Rao bound's variance over that of the robust fit on clean arcs of 81.85 degrees."""
    random = np.random.default_rng(7)
    turn = np.linspace(0.0, np.deg2rad(81.85), 2000)
    truth = 560.0 * np.column_stack((np.cos(turn), np.sin(turn)))
    found = [fit_circle(truth + random.normal(0.0, 0.5, truth.shape)).radius for _ in range(400)]
    directions = np.column_stack((np.cos(turn), np.sin(turn), np.ones(len(turn))))
    return float(0.25 * np.linalg.inv(directions.T @ directions)[2, 2] / np.var(found))


def _measure_time_ms() -> float:
    """Return the median time to measure a 1920x1080 picture."""
    camera = replace(
        CAMERA, size=(1920, 1080), focal_px=2700.0, centre_px=(965.0, 532.0), origin_px=(480.0, 300.0)
    )
    picture = Gel(Needle(RADIUS_MM, ramp_mm=3.0), camera, bubbles=10).draw()
    plane, times = camera.plane_map(), []
    for _ in range(SPEED_REPEATS):
        started = time.perf_counter()
        measure_curvature(picture, plane, CurvatureSettings())
        times.append(time.perf_counter() - started)
    return float(1e3 * np.median(times))
