"""Pictures of graph paper for tests: a camera of its own and a sheet whose every point is known."""

from dataclasses import dataclass

import cv2
import numpy as np

from labrig.vision.intrinsics import Intrinsics

# Half widths [pitches] and densities of the lines of 1, 5 and 10 pitches.
LINES = ((1, 0.05, 0.3), (5, 0.08, 0.45), (10, 0.11, 0.55))


@dataclass(frozen=True)
class PaperBench:
    """A camera over a sheet: points (right, down) [mm] from the sheet's middle, pixels through OpenCV's own lens."""

    intrinsics: Intrinsics
    mm_to_ideal: np.ndarray

    def mm(self, px):
        """Return the sheet's points (N, 2) at pixels (N, 2) of the picture."""
        model = self.intrinsics
        matrix, stop = model.camera_matrix(), (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 100, 1e-12)
        points = np.asarray(px, dtype=float).reshape(-1, 1, 2)
        lens = np.array(model.distortion)
        ideal = cv2.undistortPointsIter(points, matrix, lens, np.eye(3), matrix, stop).reshape(-1, 2)
        homogeneous = np.column_stack((ideal, np.ones(len(ideal)))) @ np.linalg.inv(self.mm_to_ideal).T
        return homogeneous[:, :2] / homogeneous[:, 2:]

    def camera_mm(self):
        """Return where the camera stands: right, down, and height over the sheet [mm]."""
        turned = np.linalg.inv(self.intrinsics.camera_matrix()) @ self.mm_to_ideal
        towards = -np.cross(turned[:, 0], turned[:, 1])
        return -np.column_stack((turned[:, :2], towards)).T @ turned[:, 2]

    def fold_mm(self, px, fold_deg):
        """Return the points (N, 2), along the paper, of a sheet whose right half rises towards the camera."""
        x, y, z = self.camera_mm()
        sheet, slope = self.mm(px), np.tan(np.deg2rad(fold_deg))
        right, down = (sheet - (x, y)).T
        along = (z - x * slope) / (z + right * slope)
        risen = np.column_stack(((x + along * right) / np.cos(np.deg2rad(fold_deg)), y + along * down))
        return np.where(sheet[:, :1] > 0.0, risen, sheet)


def make_bench(
    size=(800, 600), px_per_mm=15.6, tilt_deg=2.0, turn_deg=1.0, distortion=(-0.12, 0.03, 5e-4, -3e-4, 0.0)
):
    """Return a bench whose sheet has its middle in the picture's middle."""
    width, height = size
    focal = 1.1 * width
    intrinsics = Intrinsics(
        image_size=size,
        fx=focal,
        fy=focal * 1.002,
        cx=width / 2 + 4.3,
        cy=height / 2 - 3.1,
        distortion=distortion,
        sigma={"fx": 0.5, "fy": 0.5, "cx": 0.5, "cy": 0.5},
        rms_px=0.1,
        holdout_rms_px=0.1,
        views=(),
        accepted=True,
        reasons=(),
    )
    tilt = cv2.Rodrigues(np.deg2rad(np.array([tilt_deg, 0.7 * tilt_deg, 0.0])))[0]
    turned = tilt @ cv2.Rodrigues(np.deg2rad(np.array([0.0, 0.0, turn_deg])))[0]
    pose = np.column_stack((turned[:, :2], (0.0, 0.0, focal / px_per_mm)))
    return PaperBench(intrinsics, intrinsics.camera_matrix() @ pose)


def draw_paper(
    bench,
    *,
    noise=4.0,
    blur_px=1.0,
    seed=0,
    lines=LINES,
    uneven=0.4,
    bulge_mm=0.0,
    fold_deg=None,
    supersampling=2,
):
    """Return a grey picture of ruled paper: dark lines, heavier every five and ten, blur, uneven light, noise.

    `bulge_mm` moves the paper's points sideways, as where it is not flat; `fold_deg` folds up its right half.
    """
    width, height = bench.intrinsics.image_size
    rows, columns = np.mgrid[0 : height * supersampling, 0 : width * supersampling]
    px = (np.column_stack((columns.ravel(), rows.ravel())) - (supersampling - 1) / 2) / supersampling
    mm = bench.mm(px)
    if fold_deg is not None:
        mm = bench.fold_mm(px, fold_deg)
    mm = mm + bulge_mm * np.sin(mm[:, ::-1] / 6.0)
    dark = np.zeros(len(mm))
    for every, half_width, density in lines:
        offset = np.abs(mm - every * np.round(mm / every)).min(axis=1)
        dark = np.maximum(dark, np.where(offset < half_width, density, 0.0))
    paper = cv2.resize((1.0 - dark).reshape(rows.shape), (width, height), interpolation=cv2.INTER_AREA)
    paper = cv2.GaussianBlur(paper, (0, 0), blur_px)
    down, across = np.mgrid[0:height, 0:width]
    light = 215.0 * (1.0 - uneven * ((across / width - 0.3) ** 2 + (down / height - 0.4) ** 2))
    noisy = paper * light + np.random.default_rng(seed).normal(0.0, noise, paper.shape)
    return np.clip(np.round(noisy), 0, 255).astype(np.uint8)
