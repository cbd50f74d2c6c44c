"""Photographs of ruled sheets with known truth, from a camera of their own.

Independent of `labrig.vision` and `labrig.simulation`: a mistake that a renderer shares with the program would hide in
both. Plain NumPy and OpenCV filters; every subsample of a pixel is sent through the inverse of the lens and the sheet's
pose to mm, and is inked there if a line of the stated width in mm covers it.
"""

from dataclasses import dataclass, field, replace

import cv2
import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

# Distances between lines [mm], the finest first.
RULINGS: dict[str, tuple[float, ...]] = {
    "1/5/10": (1.0, 5.0, 10.0),
    "1/5": (1.0, 5.0),
    "1/10": (1.0, 10.0),
    "2": (2.0,),
    "2/10": (2.0, 10.0),
    "1": (1.0,),
    "5": (5.0,),
}
# How heavy these lines are: the steps of width and ink.
WEIGHTS = {
    "1/5/10": (0, 1, 2),
    "1/5": (0, 1),
    "1/10": (0, 2),
    "2": (0,),
    "2/10": (0, 2),
    "1": (0,),
    "5": (1,),
}
WIDER, DARKER = (1.0, 1.7, 2.4), (1.0, 1.2, 1.4)
# What a full line leaves of blue, green and red.
INKS = {
    "blue": (0.92, 0.60, 0.35),
    "orange": (0.30, 0.60, 0.97),
    "green": (0.45, 0.85, 0.40),
    "grey": (0.45, 0.45, 0.45),
}
PAPERS = {"white": (235.0, 235.0, 235.0), "cream": (200.0, 225.0, 235.0)}
_TABLE = 4096


@dataclass(frozen=True)
class Camera:
    """A pinhole with two radial terms."""

    size: tuple[int, int] = (1280, 720)
    focal_px: float = 1500.0
    centre_px: tuple[float, float] = (640.0, 360.0)
    k1: float = -0.1
    k2: float = 0.02

    def rays(self, px: FloatArray) -> FloatArray:
        """Return the slopes (N, 2) of the rays that end at pixels (N, 2); the radius is inverted by a fine table."""
        distorted = (px - self.centre_px) / self.focal_px
        radius = np.linspace(0.0, 1.2, _TABLE)
        bent = radius * (1.0 + self.k1 * radius**2 + self.k2 * radius**4)
        rising = np.append(np.diff(bent) > 0.0, True)
        last = len(rising) if rising.all() else int(np.argmin(rising))
        r = np.hypot(*distorted.T)
        straight = np.interp(r, bent[:last], radius[:last])
        # One Newton step leaves an error far below a thousandth of a pixel.
        slope = 1.0 + 3.0 * self.k1 * straight**2 + 5.0 * self.k2 * straight**4
        straight -= (straight * (1.0 + self.k1 * straight**2 + self.k2 * straight**4) - r) / slope
        return np.asarray(distorted * (straight / np.maximum(r, 1e-12))[:, None])


@dataclass(frozen=True)
class Sheet:
    """A sheet before a camera, and all that its picture depends on.

    `px_per_mm` holds in the picture's middle; `extent_mm` is the ruled part (left, top, right, bottom) from there;
    `margin_mm` the bare paper around it, `behind` the grey level of what lies beyond the paper.
    """

    ruling: str = "1/5/10"
    px_per_mm: float = 8.0
    camera: Camera = field(default_factory=Camera)
    tilt_deg: float = 0.0
    tilt_towards_deg: float = 0.0
    roll_deg: float = 0.0
    shift_mm: tuple[float, float] = (0.3, 0.4)
    ink: str = "blue"
    paper: str = "white"
    width_mm: float = 0.12
    density: float = 0.6
    blur_px: float = 0.8
    noise: float = 3.0
    unevenness: float = 0.3
    vignetting: float = 0.3
    extent_mm: tuple[float, float, float, float] | None = None
    margin_mm: float = 4.0
    behind: float = 70.0
    seed: int = 0
    grey: bool = False

    @property
    def pitch_mm(self) -> float:
        """Return the distance between the finest lines."""
        return RULINGS[self.ruling][0]

    def pose(self) -> tuple[FloatArray, FloatArray]:
        """Return rotation (3, 3) and translation (3,) [mm] from the sheet to the camera."""
        towards, tilt, roll = np.deg2rad([self.tilt_towards_deg, self.tilt_deg, self.roll_deg])
        axis = np.array([np.cos(towards), np.sin(towards), 0.0])
        lean = cv2.Rodrigues(tilt * axis)[0]
        spin = cv2.Rodrigues(np.array([0.0, 0.0, roll]))[0]
        return lean @ spin, np.array([0.0, 0.0, self.camera.focal_px / self.px_per_mm])

    def to_mm(self, px: FloatArray) -> FloatArray:
        """Return the points of the sheet (N, 2) [mm] that appear at pixels (N, 2)."""
        rotation, translation = self.pose()
        slopes = self.camera.rays(np.asarray(px, dtype=float))
        rays = np.column_stack((slopes, np.ones(len(slopes)))) @ rotation
        foot = translation @ rotation
        return np.asarray(foot[2] / rays[:, 2:] * rays[:, :2] - foot[:2])

    def is_inside(self, mm: FloatArray, margin_mm: float) -> NDArray[np.bool_]:
        """Return whether points (..., 2) lie on the ruled part or at most `margin_mm` beside it."""
        if self.extent_mm is None:
            return np.ones(mm.shape[:-1], dtype=bool)
        left, top, right, bottom = self.extent_mm
        x, y = mm[..., 0], mm[..., 1]
        beside = np.maximum(np.maximum(left - x, x - right), np.maximum(top - y, y - bottom))
        return np.asarray(beside <= margin_mm)

    def picture_size_mm(self) -> tuple[float, float]:
        """Return how wide and high the picture is on the sheet, through its middle [mm]."""
        width, height = self.camera.size
        ends = [(0, height / 2), (width, height / 2), (width / 2, 0), (width / 2, height)]
        left, right, top, bottom = self.to_mm(np.array(ends, dtype=float))
        return float(np.linalg.norm(right - left)), float(np.linalg.norm(bottom - top))


def draw_sheet(sheet: Sheet, supersampling: int = 4) -> NDArray[np.uint8]:
    """Return the picture of a sheet (H, W, 3), blue-green-red; (H, W) for a grey camera."""
    width, height = sheet.camera.size
    random = np.random.default_rng(sheet.seed)
    desk = sheet.behind + 12.0 * cv2.GaussianBlur(random.normal(0.0, 1.0, (height, width)), (0, 0), 3.0)
    share, ink = _cover(sheet, supersampling)
    clean = [
        level * (share - (1.0 - full) * ink) + (1.0 - share) * desk
        for level, full in zip(PAPERS[sheet.paper], INKS[sheet.ink], strict=True)
    ]
    blurred = cv2.GaussianBlur(np.dstack(clean), (0, 0), sheet.blur_px)
    lit = blurred * _light(sheet, random)[..., None]
    if sheet.grey:
        lit = lit @ np.array([0.114, 0.587, 0.299])
    noisy = lit + random.normal(0.0, sheet.noise, lit.shape)
    return np.clip(np.round(noisy), 0, 255).astype(np.uint8)


def _cover(sheet: Sheet, supersampling: int) -> FloatArray:
    """Return how much of each pixel (2, H, W) is paper, and how much print is on it.

    The places of the pixels' corners are exact; the subsamples of a pixel lie evenly between them.
    """
    width, height = sheet.camera.size
    corners = np.meshgrid(np.arange(width + 1) - 0.5, np.arange(height + 1) - 0.5)
    flat = sheet.to_mm(np.column_stack([axis.ravel() for axis in corners]))
    # Single precision is 0.00003 mm here; one plane for each coordinate is computed with several times as fast.
    planes = np.ascontiguousarray(flat.T, dtype=np.float32).reshape(2, height + 1, width + 1)
    places = np.moveaxis(planes, 0, -1)
    cover = np.zeros((2, height, width))
    steps = (np.arange(supersampling) + 0.5) / supersampling
    for down in steps:
        edge = (1.0 - down) * places[:-1] + down * places[1:]
        for across in steps:
            mm = (1.0 - across) * edge[:, :-1] + across * edge[:, 1:]
            cover[0] += sheet.is_inside(mm, sheet.margin_mm)
            cover[1] += _ink(sheet, mm)
    return np.asarray(cover / supersampling**2)


def _ink(sheet: Sheet, mm: FloatArray) -> FloatArray:
    """Return the ink from 0 to 1 at points of the sheet (..., 2): heavier lines are wider and darker."""
    ink = np.zeros(mm.shape[:-1])
    for every, weight in zip(RULINGS[sheet.ruling], WEIGHTS[sheet.ruling], strict=True):
        placed = (mm - np.array(sheet.shift_mm, dtype=mm.dtype)) / every
        away = np.abs(placed - np.rint(placed))
        near = np.minimum(away[..., 0], away[..., 1]) < 0.5 * sheet.width_mm * WIDER[weight] / every
        ink = np.maximum(ink, min(sheet.density * DARKER[weight], 1.0) * near)
    return np.asarray(ink * sheet.is_inside(mm, 0.0))


def _light(sheet: Sheet, random: np.random.Generator) -> FloatArray:
    """Return the light (H, W): a slope across the picture, a broad spot, and the fall-off to the corners."""
    width, height = sheet.camera.size
    v, u = np.mgrid[:height, :width]
    x, y = (u - width / 2) / (width / 2), (v - height / 2) / (width / 2)
    angle, place = random.uniform(0.0, 2.0 * np.pi), random.uniform(-0.6, 0.6, 2)
    slope = np.cos(angle) * x + np.sin(angle) * y
    spot = np.exp(-((x - place[0]) ** 2 + (y - place[1]) ** 2) / 0.5)
    uneven = 1.0 + sheet.unevenness * (0.4 * slope + 0.6 * (spot - 0.6))
    fall = 1.0 - sheet.vignetting * (x**2 + y**2) / 1.3
    return np.asarray(uneven / uneven.max() * fall)


def draw_shop_sheet(seed: int, band: tuple[float, float], ruling: str, on_bench: bool) -> Sheet:
    """Return a sheet as shops sell them, before a focussed camera, at random over a band of scales [px/mm].

    A sheet on a bench does not fill the picture: one to three of its edges lie in it.
    """
    random = np.random.default_rng(seed)
    camera = Camera(
        focal_px=float(random.uniform(1000.0, 2200.0)),
        centre_px=(640.0 + float(random.uniform(-15, 15)), 360.0 + float(random.uniform(-15, 15))),
        k1=float(random.uniform(-0.25, 0.05)),
        k2=float(random.uniform(0.0, 0.06)),
    )
    low, high = band
    if ruling == "5":
        high = max(min(high, 14.0), low)
    sheet = Sheet(
        ruling=ruling,
        px_per_mm=float(np.exp(random.uniform(np.log(low), np.log(high)))),
        camera=camera,
        tilt_deg=float(random.uniform(0.0, 25.0)),
        tilt_towards_deg=float(random.uniform(0.0, 360.0)),
        roll_deg=float(random.uniform(-25.0, 25.0)),
        shift_mm=(float(random.uniform(0, 10)), float(random.uniform(0, 10))),
        ink=str(random.choice(list(INKS))),
        paper=str(random.choice(list(PAPERS))),
        width_mm=float(random.uniform(0.1, 0.25)),
        density=float(random.uniform(0.35, 0.8)),
        blur_px=float(random.uniform(0.4, 0.9)),
        noise=float(random.uniform(1.0, 4.0)),
        unevenness=float(random.uniform(0.0, 0.9)),
        vignetting=float(random.uniform(0.0, 0.5)),
        margin_mm=float(random.choice([0.0, 3.0, 10.0])),
        behind=float(random.uniform(10.0, 100.0)),
        seed=seed,
        grey=bool(random.random() < 0.2),
    )
    return replace(sheet, extent_mm=_cut(sheet, random)) if on_bench else sheet


def _cut(sheet: Sheet, random: np.random.Generator) -> tuple[float, float, float, float]:
    """Return a ruled part whose edges lie in the picture on one to three sides."""
    width, height = (length / 2 for length in sheet.picture_size_mm())
    far = 10.0 * width
    sides = [-far, -far, far, far]
    for side in random.permutation(4)[: random.integers(1, 4)]:
        half = height if side % 2 else width
        sides[side] = (-1.0 if side < 2 else 1.0) * half * float(random.uniform(0.5, 0.9))
    return sides[0], sides[1], sides[2], sides[3]
