"""Pictures of paper, boards and needles, with known truth, by a camera that shares nothing with the program.

Independent of `labrig.simulation` and of what `labrig.vision` computes: a mistake that a renderer shares with the
program would hide in both. Places are mm in the plane, columns (right, down) as they point in an upright picture, from
the point that `Camera.origin_px` sees; headings and curvatures are positive downwards.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from labrig.vision.intrinsics import Intrinsics
from labrig.vision.plane import Insertion, PlaneMap

FloatArray = NDArray[np.float64]
Picture = NDArray[np.uint8]
Grid = NDArray[Any]

FRAMES = {
    "right": ((0.0, -1.0), (1.0, 0.0)), "down": ((1.0, 0.0), (0.0, 1.0)), "left": ((0.0, 1.0), (-1.0, 0.0)),
    "up": ((-1.0, 0.0), (0.0, -1.0)),
}  # fmt: skip
"""Where (right, down) lies in (y, z) for each direction of the insertion, as rows y and z."""


@dataclass(frozen=True)
class Camera:
    """A pinhole with OpenCV's five coefficients before a plane that leans by `tilt_deg` towards a direction.

    `roll_deg` turns what lies in the plane. Without `origin_px` the origin lies on the optical axis.
    """

    size: tuple[int, int] = (1280, 720)
    focal_px: float = 1800.0
    centre_px: tuple[float, float] = (645.0, 352.0)
    distortion: tuple[float, float, float, float, float] = (-0.12, 0.05, 0.0, 0.0, 0.0)
    distance_mm: float = 115.4
    tilt_deg: float = 2.0
    towards_deg: float = 73.3
    roll_deg: float = 0.0
    origin_px: tuple[float, float] | None = None
    aspect: float = 1.0

    @property
    def px_per_mm(self) -> float:
        """The scale on the optical axis."""
        return self.focal_px / self.distance_mm

    @property
    def matrix(self) -> FloatArray:
        """The camera's matrix (3, 3)."""
        u, v = self.centre_px
        return np.array([[self.focal_px, 0.0, u], [0.0, self.aspect * self.focal_px, v], [0.0, 0.0, 1.0]])

    @property
    def intrinsics(self) -> Intrinsics:
        """The lens as a calibration states it."""
        sigma: dict[str, float | None] = dict.fromkeys(("fx", "fy", "cx", "cy"), 0.5)
        focal = (self.focal_px, self.aspect * self.focal_px, *self.centre_px)
        return Intrinsics(self.size, *focal, self.distortion, sigma, 0.1, 0.1, (), True, ())

    def plane_map(self, insertion: Insertion = "right") -> PlaneMap:
        """Return the exact map, as a perfect calibration would."""
        frame = np.eye(3)
        frame[:2, :2] = FRAMES[insertion]
        return PlaneMap(
            homography=frame @ np.linalg.inv(self.matrix @ self._pose()),
            intrinsics=self.intrinsics,
            origin_px=self.origin_px or self.centre_px,
            insertion=insertion,
            image_size=self.size,
            mm_per_px=1.0 / self.px_per_mm,
        )

    def project(self, points: FloatArray) -> FloatArray:
        """Return the pixels (N, 2) of points (N, 3) before the camera."""
        x, y = self._bend(*(points[:, :2] / points[:, 2:]).T)
        return np.column_stack((x, y, np.ones(len(x)))) @ self.matrix.T[:, :2]

    def to_px(self, mm: ArrayLike, depth_mm: ArrayLike = 0.0) -> FloatArray:
        """Return the pixels (N, 2) of points (N, 2) so far behind the plane."""
        pose, places = self._pose(), np.asarray(mm, dtype=float)
        behind = np.multiply.outer(np.asarray(depth_mm, dtype=float), np.cross(pose[:, 0], pose[:, 1]))
        return self.project(np.column_stack((places, np.ones(len(places)))) @ pose.T + behind)

    def to_mm(self, px: ArrayLike) -> FloatArray:
        """Return the points (N, 2) of the plane that appear at pixels (N, 2)."""
        seen = (np.asarray(px, dtype=float) - self.centre_px) / (self.focal_px, self.aspect * self.focal_px)
        wanted = straight = seen.T
        for _ in range(100 if any(self.distortion) else 0):
            off = wanted - self._bend(*straight)
            straight = straight + off
            if np.abs(off).max(initial=0.0) < 1e-11:
                break
        flat = np.linalg.inv(self._pose()) @ np.vstack((straight, np.ones(len(seen))))
        return np.asarray((flat[:2] / flat[2]).T)

    def picture_size_mm(self) -> tuple[float, float]:
        """Return how wide and high the picture is in the plane, through its middle."""
        width, height = self.size
        ends = ((0, height / 2), (width, height / 2), (width / 2, 0), (width / 2, height))
        left, right, top, bottom = self.to_mm(ends)
        return float(np.linalg.norm(right - left)), float(np.linalg.norm(bottom - top))

    def _bend(self, x: FloatArray, y: FloatArray) -> FloatArray:
        k1, k2, p1, p2, k3 = self.distortion
        s = x**2 + y**2
        radial = 1.0 + s * (k1 + s * (k2 + s * k3))
        across, down = 2.0 * p1 * x * y + p2 * (s + 2.0 * x**2), p1 * (s + 2.0 * y**2) + 2.0 * p2 * x * y
        return np.array((x * radial + across, y * radial + down))

    def _pose(self) -> FloatArray:
        """Return the matrix (3, 3) from (right, down, 1) to points before the camera."""
        towards, tilt, roll = np.deg2rad((self.towards_deg, self.tilt_deg, self.roll_deg))
        lean = cv2.Rodrigues(tilt * np.array([np.cos(towards), np.sin(towards), 0.0]))[0]
        turn = lean @ cv2.Rodrigues(np.array([0.0, 0.0, roll]))[0]
        pose = np.column_stack((turn[:, :2], (0.0, 0.0, self.distance_mm)))
        if self.origin_px is not None:
            pose[:, 2] += pose[:, :2] @ replace(self, origin_px=None).to_mm([self.origin_px])[0]
        return pose


def flat_camera(px_per_mm: float = 10.0, size: tuple[int, int] = (960, 540)) -> Camera:
    """Return a camera so far away that a scale is the whole map, with the origin at pixel (0, 0)."""
    return Camera(size, 1e6, (0.0, 0.0), (0.0,) * 5, 1e6 / px_per_mm, 0.0)


@lru_cache(4)
def see_plane(camera: Camera, step: float) -> Grid:
    """Return the plane's points (2, H, W) at pixels a step apart: at centres for 0, else at corners.

    Single precision is 0.00003 mm here, and what is computed from it several times as fast.
    """
    width, height = camera.size
    grid = np.meshgrid(np.arange(width + step) - 0.5 * step, np.arange(height + step) - 0.5 * step)
    mm = camera.to_mm(np.column_stack([axis.ravel() for axis in grid]))
    return np.ascontiguousarray(mm.T, dtype=np.float32).reshape(2, *grid[0].shape)


@dataclass(frozen=True)
class Photo:
    """How a picture is lit and taken.

    The light rises by `slope` across the picture, in a random direction if none is named, and by a broad `spot`; it
    falls by `fall` to the corners. A point is spread by a Gaussian, and as a `halo` by one that is five times as wide.
    """

    slope: float = 0.0
    spot: float = 0.0
    fall: float = 0.0
    towards_rad: float | None = None
    blur_px: float = 0.8
    halo: float = 0.0
    noise: float = 3.0
    grey: bool = True
    seed: int = 0

    def take(self, scene: FloatArray) -> Picture:
        """Return the picture (H, W) or (H, W, 3), blue-green-red, of grey levels in even light."""
        random = np.random.default_rng((self.seed, 1))
        image = scene @ np.array([0.114, 0.587, 0.299]) if self.grey and scene.ndim == 3 else scene
        light = self._light(random, *scene.shape[1::-1])
        image = image * (light if image.ndim == 2 else light[..., None])
        image = image.astype(np.float32)
        wide = cv2.GaussianBlur(image, (0, 0), 5.0 * self.blur_px) if self.halo else 0.0
        image = (1.0 - self.halo) * cv2.GaussianBlur(image, (0, 0), self.blur_px) + self.halo * wide
        image += np.float32(self.noise) * random.standard_normal(image.shape, np.float32)
        return np.clip(np.rint(image), 0, 255).astype(np.uint8)

    def _light(self, random: np.random.Generator, width: int, height: int) -> FloatArray:
        x, y = (2.0 * np.arange(size) / width - size / width for size in (width, height))
        y = y[:, None]
        drawn, (right, down) = random.uniform(0.0, 2.0 * np.pi), random.uniform(-0.6, 0.6, 2)
        angle = drawn if self.towards_rad is None else self.towards_rad
        light = 1.0 + self.slope * (np.cos(angle) * x + np.sin(angle) * y)
        if self.spot:
            light = light + self.spot * (np.exp(-((x - right) ** 2 + (y - down) ** 2) / 0.5) - 0.6)
            light = light / light.max()
        return np.asarray(light * (1.0 - self.fall * (x**2 + y**2)))


RULINGS: dict[str, tuple[tuple[float, int], ...]] = {
    "1/5/10": ((1.0, 0), (5.0, 1), (10.0, 2)), "1/5": ((1.0, 0), (5.0, 1)), "1/10": ((1.0, 0), (10.0, 2)),
    "2": ((2.0, 0),), "1": ((1.0, 0),), "5": ((5.0, 1),),
}  # fmt: skip
"""Distances between lines [mm], the finest first, and how heavy these are: the steps of width and ink."""
WIDER, DARKER = (1.0, 1.7, 2.4), (1.0, 1.2, 1.4)
INKS = {
    "blue": (0.92, 0.60, 0.35), "orange": (0.30, 0.60, 0.97), "green": (0.45, 0.85, 0.40),
    "grey": (0.45, 0.45, 0.45),
}  # fmt: skip
"""What a full line leaves of blue, green and red."""
PAPERS = {"white": (235.0, 235.0, 235.0), "cream": (200.0, 225.0, 235.0)}


@dataclass(frozen=True)
class Sheet:
    """A ruled sheet before a camera.

    `extent_mm` is the ruled part (left, top, right, bottom), `margin_mm` the bare paper around it, `behind` the grey
    level of what lies beyond. `bulge_mm` moves the sheet's points sideways, as where it is not flat. A pixel is the
    mean of `samples` squared.
    """

    ruling: str = "1/5/10"
    camera: Camera = field(default_factory=Camera)
    photo: Photo = field(default_factory=lambda: Photo(0.12, 0.18, 0.23, grey=False))
    shift_mm: tuple[float, float] = (0.3, 0.4)
    ink: str = "blue"
    paper: str = "white"
    width_mm: float = 0.12
    density: float = 0.6
    extent_mm: tuple[float, float, float, float] | None = None
    margin_mm: float = 4.0
    behind: float = 70.0
    bulge_mm: float = 0.0
    samples: int = 3

    @property
    def pitch_mm(self) -> float:
        """The distance between the finest lines."""
        return RULINGS[self.ruling][0][0]

    def draw(self) -> Picture:
        """Return the picture; each line is drawn where the middle of a sample is covered by its width in mm."""
        width, height = self.camera.size
        print_, cover = np.zeros((2, height, width), np.float32)
        corners = see_plane(self.camera, 1.0)
        if self.bulge_mm:
            corners = corners + np.float32(self.bulge_mm) * np.sin(corners[::-1] / np.float32(6.0))
        steps = (np.arange(self.samples, dtype=np.float32) + np.float32(0.5)) / self.samples
        for down in steps:
            edge = (1 - down) * corners[:, :-1] + down * corners[:, 1:]
            for across in steps:
                mm = (1 - across) * edge[..., :-1] + across * edge[..., 1:]
                cover += self.is_inside(mm, self.margin_mm)
                print_ += self._ink(mm)
        print_ /= self.samples**2
        cover /= self.samples**2
        random = np.random.default_rng((self.photo.seed, 2))
        desk: Any = self.behind
        if self.extent_mm is not None:
            desk = desk + 12.0 * cv2.GaussianBlur(random.normal(0.0, 1.0, (height, width)), (0, 0), 3.0)
        clean = [
            level * (cover - (1.0 - full) * print_) + (1.0 - cover) * desk
            for level, full in zip(PAPERS[self.paper], INKS[self.ink], strict=True)
        ]
        return self.photo.take(np.dstack(clean))

    def is_inside(self, mm: Grid, margin_mm: float = 0.0) -> NDArray[np.bool_]:
        """Return whether points (2, ...) lie on the ruled part or at most `margin_mm` beside it."""
        if self.extent_mm is None:
            return np.ones(mm.shape[1:], dtype=bool)
        left, top, right, bottom = self.extent_mm
        beside = np.maximum(np.maximum(left - mm[0], mm[0] - right), np.maximum(top - mm[1], mm[1] - bottom))
        return np.asarray(beside <= margin_mm)

    def length_error(self, plane: PlaneMap) -> float:
        """Return the largest relative error of a length in any direction, over the paper in the picture."""
        width, height = self.camera.size
        grid = np.meshgrid(np.linspace(0, width - 1, 33), np.linspace(0, height - 1, 19))
        px = np.column_stack([axis.ravel() for axis in grid])
        true = self.camera.to_mm(px)
        inside = self.is_inside(true.T)
        design = np.column_stack((true, np.ones(len(true))))[inside]
        affine = np.linalg.lstsq(design, plane.to_mm(px[inside]), rcond=None)[0]
        return float(np.abs(np.linalg.svd(affine[:2], compute_uv=False) - 1.0).max())

    def _ink(self, mm: Grid) -> Grid:
        """Return the ink from 0 to 1 at points of the sheet: heavier lines are wider and darker."""
        ink = np.zeros(mm.shape[1:], np.float32)
        shift = np.array(self.shift_mm, np.float32)[:, None, None]
        for every, weight in RULINGS[self.ruling]:
            placed = (mm - shift) / np.float32(every)
            away = np.abs(placed - np.rint(placed)).min(axis=0)
            dark = np.float32(min(self.density * DARKER[weight], 1.0))
            ink = np.maximum(ink, dark * (away < 0.5 * self.width_mm * WIDER[weight] / every))
        return ink * self.is_inside(mm)


_STEP_MM, _BACK_MM = 0.02, 80.0


@dataclass(frozen=True)
class Needle:
    """A sheath, straight from far outside up to `entry_mm`, and a needle that leaves it on an arc.

    Its curvature grows over `ramp_mm`; a negative length leaves it inside the sheath, and `roll_rad` turns it about its
    axis out of the plane. The bevel is cut from the side to which it bends, and darkness fades over it by `fade`.
    Steel has a grey level; a lamp towards `lamp_rad` brightens it by `lamp` where it faces that, `height` is the sine
    of its elevation, and `glint` its reflection. `shading` is by how many levels the lower edge is brighter than the
    upper one, and `line` the brightness of a thin line `line_at` of the half width below the middle.
    """

    radius_mm: float = 28.0
    length_mm: float = 40.0
    entry_mm: tuple[float, float] = (0.0, 0.0)
    heading_rad: float = 0.0
    bend: int = 1
    ramp_mm: float = 0.0
    roll_rad: float = 0.0
    diameter_mm: float = 1.2
    sheath_mm: float = 2.0
    bevel: float = 1.43
    fade: float = 0.0
    level: float = 62.0
    sheath_level: float = 70.0
    lamp: float = 0.0
    lamp_rad: float = 0.0
    height: float = 0.5
    glint: float = 0.0
    shadow: float = 0.0
    shading: float = 0.0
    line: float = 163.0
    line_at: float = -0.4

    def path_mm(self) -> FloatArray:
        """Return points (N, 2) of the centre line from the sheath's tip on, `_STEP_MM` apart."""
        s = np.arange(0.0, max(self.length_mm, 1.0) + 0.5 * _STEP_MM, _STEP_MM)
        bend = self.bend / self.radius_mm
        start = np.minimum(s, self.ramp_mm)
        turn = bend * (s - start + (0.5 * start**2 / self.ramp_mm if self.ramp_mm else 0.0))
        middle = 0.5 * (turn[1:] + turn[:-1])
        # The chord of an arc is shorter than it.
        chord = _STEP_MM * np.sinc(0.5 * np.diff(turn) / np.pi)
        aside = chord * np.sin(middle) * np.cos(self.roll_rad)
        moves = np.vstack(([(0.0, 0.0)], np.column_stack((chord * np.cos(middle), aside))))
        return np.asarray(self.entry_mm + np.cumsum(moves, axis=0) @ self._turn())

    @property
    def tip_mm(self) -> FloatArray:
        """The end of the centre line, level with the foremost point of the bevel."""
        return np.asarray(self.path_mm()[-1])

    @property
    def centre_mm(self) -> FloatArray:
        """The arc's centre, of a needle without a ramp."""
        return np.asarray(self.entry_mm + np.array([0.0, self.bend * self.radius_mm]) @ self._turn())

    def half_mm(self, along: FloatArray) -> FloatArray:
        """Return half the width at distances along the needle."""
        return np.full(along.shape, 0.5 * self.diameter_mm)

    def draw(self, image: FloatArray, mm: Grid, camera: Camera) -> None:
        """Draw sheath, needle and shadow into an image whose pixels show points (2, H, W) of the plane."""

        def cover(inside_mm: FloatArray) -> FloatArray:
            return np.clip(0.5 + inside_mm * camera.px_per_mm, 0.0, 1.0)

        (rows, columns), along, across, normal, reach = self._locate(mm, camera)
        half, level = self.half_mm(along), image[rows, columns]
        beside = np.cos(self.lamp_rad - normal)
        dark = np.abs(beside) * np.exp(-0.5 * ((across / self.diameter_mm + 0.6 * beside) / 0.5) ** 2)
        level *= 1.0 - self.shadow * dark
        end = reach - self.bevel * (across * self.bend + half)
        needle = cover(half - np.abs(across)) * cover((end - along) / np.hypot(1.0, self.bevel))
        needle *= 1.0 - self.fade * np.clip(1.0 - (end - along) / self.diameter_mm, 0.0, 1.0)
        wide = np.full(along.shape, 0.5 * self.sheath_mm)
        sheath = cover(wide - np.abs(across)) * cover(-along)
        for share, width, steel in ((needle, half, self.level), (sheath, wide, self.sheath_level)):
            aside = np.clip(across / width, -1.0, 1.0)
            shine = self._shine(aside, normal) + self.line * cover(
                (0.12 - np.abs(aside - self.line_at)) * width
            )
            level += share * (steel + shine - level)
        image[rows, columns] = level

    def _turn(self) -> FloatArray:
        c, s = np.cos(self.heading_rad), np.sin(self.heading_rad)
        return np.array([[c, s], [-s, c]])

    def _locate(self, mm: Grid, camera: Camera) -> tuple[Any, FloatArray, FloatArray, FloatArray, float]:
        """Return the pixels near the path, how far along and across it they are, its normal, and where it ends."""
        path = self.path_mm()
        first = (path[1] - path[0]) / np.linalg.norm(path[1] - path[0])
        reach = 0.5 * max(self.sheath_mm, self.diameter_mm) + (1.5 * self.diameter_mm if self.shadow else 0.3)
        near = np.zeros(camera.size[::-1], np.uint8)
        course = np.vstack((path[0] - np.arange(_BACK_MM, 0.0, -0.5)[:, None] * first, path[::10], path[-1:]))
        line = np.rint(np.clip(camera.to_px(course), -20000, 20000)).astype(np.int32)
        cv2.polylines(near, [line], False, 1, 2 + int(2.2 * reach * camera.px_per_mm))
        pixels = rows, columns = np.nonzero(near)
        places = mm[:, rows, columns].astype(float).T
        s = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))))
        heading = np.unwrap(np.arctan2(*np.gradient(path, axis=0).T[::-1]))
        curvature = np.gradient(heading, s)
        ahead = (places - path[0]) @ first > 0.0
        index = np.zeros(len(places), int)
        index[ahead] = np.clip(cKDTree(path).query(places[ahead])[1], 2, len(path) - 3)
        angle = np.where(ahead, heading[index], np.arctan2(*first[::-1]))
        k = np.where(ahead & (np.abs(curvature[index]) > 1e-7), curvature[index], 1e-7)
        right, down = (places - path[index]).T
        a = right * np.cos(angle) + down * np.sin(angle)
        c = down * np.cos(angle) - right * np.sin(angle)
        on = np.arctan2(k * a, 1.0 - k * c) / k
        across = (1.0 - np.hypot(k * a, 1.0 - k * c)) / k
        return (
            pixels, s[index] + on, across, angle + k * on + 0.5 * np.pi,
            s[-1] + min(self.length_mm - 1.0, 0.0),
        )  # fmt: skip

    def _shine(self, aside: FloatArray, normal: FloatArray) -> FloatArray:
        """Return what the lamp adds to a cylinder's surface (Lambert's cosine law, and Blinn's glint)."""
        up = np.sqrt(1.0 - aside**2)
        flat = np.sqrt(1.0 - self.height**2) * np.cos(self.lamp_rad - normal)
        lit = np.maximum(aside * flat + up * self.height, 0.0)
        # Half way between the lamp and the camera, which looks straight down.
        halfway = np.sqrt(2.0 + 2.0 * self.height)
        mirrored = np.maximum((aside * flat + up * (1.0 + self.height)) / halfway, 0.0)
        return self.lamp * lit + self.glint * mirrored**60 + 0.5 * self.shading * aside


@dataclass(frozen=True)
class Bar:
    """A straight bar: a wall, a wire, a scratch; `opacity` is how much of what lies below it the bar hides."""

    centre_mm: tuple[float, float]
    angle_rad: float
    width_mm: float
    level: float
    opacity: float = 1.0
    length_mm: float = 1000.0

    def draw(self, image: FloatArray, mm: Grid, camera: Camera) -> None:
        """Draw the bar."""
        right, down = mm[0] - self.centre_mm[0], mm[1] - self.centre_mm[1]
        across = np.abs(down * np.cos(self.angle_rad) - right * np.sin(self.angle_rad))
        along = np.abs(right * np.cos(self.angle_rad) + down * np.sin(self.angle_rad))
        inside_mm = np.minimum(0.5 * self.width_mm - across, 0.5 * self.length_mm - along)
        image += np.clip(0.5 + inside_mm * camera.px_per_mm, 0.0, 1.0) * self.opacity * (self.level - image)


@dataclass(frozen=True)
class Gel:
    """Gel before a camera, with what stands in it, below first; `tracks_mm` are courses of earlier needles aside."""

    needle: Needle | None = field(default_factory=Needle)
    camera: Camera = field(default_factory=lambda: Camera(origin_px=(320.0, 200.0)))
    photo: Photo = field(default_factory=lambda: Photo(0.15, fall=0.15))
    level: float = 165.0
    below: tuple[Bar | Needle, ...] = ()
    above: tuple[Bar, ...] = ()
    tracks_mm: tuple[float, ...] = (10.0, 20.0, -10.0)
    bubbles: int = 25

    def draw(self) -> Picture:
        """Return the picture (H, W)."""
        random = np.random.default_rng((self.photo.seed, 3))
        mm = see_plane(self.camera, 0.0)
        image = np.full(mm.shape[1:], self.level)
        for aside in self.tracks_mm:
            self._draw_track(image, aside, random)
        for _ in range(self.bubbles):
            centre, radius = random.uniform((0, 0), self.camera.size).astype(int), random.uniform(0.2, 0.6)
            mark = np.zeros(image.shape, np.uint8)
            cv2.circle(mark, centre.tolist(), int(radius * self.camera.px_per_mm), 255, 2, cv2.LINE_AA)
            image += mark * (random.choice((-30.0, 30.0)) / 255.0)
        for shown in (*self.below, self.needle, *self.above):
            if shown is not None:
                shown.draw(image, mm, self.camera)
        return self.photo.take(image)

    def take(self, seed: int, **changes: object) -> Picture:
        """Return another picture, with these changes."""
        changed = replace(self, **changes)  # type: ignore[arg-type]
        return replace(changed, photo=replace(changed.photo, seed=seed)).draw()

    def _draw_track(self, image: FloatArray, aside_mm: float, random: np.random.Generator) -> None:
        model = self.needle or Needle()
        entry = (model.entry_mm[0], model.entry_mm[1] + aside_mm)
        radius_mm = model.radius_mm + random.normal(0.0, 0.5)
        course = replace(model, radius_mm=radius_mm, length_mm=40.0, entry_mm=entry)
        line = np.rint(self.camera.to_px(course.path_mm()[::20])).astype(np.int32)
        width = max(1, int(random.uniform(0.3, 0.6) * self.camera.px_per_mm))
        mark = np.zeros(image.shape, np.uint8)
        cv2.polylines(mark, [line], False, 255, width, cv2.LINE_AA)
        image -= cv2.GaussianBlur(mark, (0, 0), 1.0) * (random.uniform(15.0, 25.0) / 255.0)


Light = Literal[
    "even", "lamp inside the bend", "lamp outside the bend", "lamp along the needle", "shaded across"
]


def draw_side_lit(seed: int, radii_mm: tuple[float, float], light: Light) -> Gel:
    """Return a needle of a seed: 24 to 50 mm of an arc, seen at 7 to 14 px/mm, with a lamp of 5 to 35 grey levels.

    The lamp stands within 40 degrees of its direction. With it come a glint, a shadow and a slope of the gel's grey.
    Steel "shaded across" is 8 to 16 levels brighter at one edge, and has a bright line on that side of its middle.
    """
    random = np.random.default_rng((seed, *map(int, radii_mm)))
    radius_mm, bend = random.uniform(*radii_mm), int(random.choice((-1, 1)))
    length_mm = float(np.clip(random.uniform(0.9, 1.5) * radius_mm, 24.0, 50.0))
    heading_rad = random.normal(0.0, 0.03)
    inside = heading_rad + bend * (0.5 * length_mm / radius_mm + 0.5 * np.pi)
    towards = {
        "even": 0.0,
        "lamp inside the bend": inside,
        "lamp outside the bend": inside + np.pi,
        "lamp along the needle": inside + random.choice((-0.5, 0.5)) * np.pi,
        "shaded across": 0.0,
    }[light]
    lit = light not in {"even", "shaded across"}
    side = int(random.choice((-1, 1))) if light == "shaded across" else 0
    entry_mm = (random.uniform(8.0, 18.0), 24.5 - 12.0 * bend + random.uniform(-3.0, 3.0))
    px_per_mm, level = random.uniform(7.0, 14.0), random.uniform(140.0, 185.0)
    slope, fall, ambient = random.uniform((0.0, 0.0, 40.0), (0.3, 0.2, 65.0)).tolist()
    needle = Needle(
        radius_mm, length_mm, entry_mm, heading_rad, bend, bevel=1.5, level=ambient, sheath_level=ambient,
        lamp=lit * random.uniform(5.0, 35.0), lamp_rad=towards + random.uniform(-0.7, 0.7),
        height=random.uniform(0.2, 0.8), glint=lit * random.uniform(0.0, 80.0), shadow=lit * random.uniform(0.0, 0.06),
        shading=side * random.uniform(8.0, 16.0), line=abs(side) * random.uniform(20.0, 100.0),
        line_at=side * random.uniform(0.2, 0.5),
    )  # fmt: skip
    blur_px, halo, noise = random.uniform((0.6, 0.0, 1.5), (1.3, 0.1, 5.0)).tolist()
    photo = Photo(0.5 * lit * slope, 0.0, 0.25 * fall, needle.lamp_rad, blur_px, halo, noise, seed=seed)
    size = (round(87.0 * px_per_mm), round(49.0 * px_per_mm))
    return Gel(needle, flat_camera(px_per_mm, size), photo, level, tracks_mm=(), bubbles=0)


@dataclass(frozen=True)
class Board:
    """A board of corners whose height towards the camera [mm] is a function of (x, y), each from -1 to 1 over it."""

    columns: int = 9
    rows: int = 6
    square_mm: float = 25.0
    height_mm: Callable[[FloatArray, FloatArray], FloatArray] = lambda x, y: 0.0 * x

    @property
    def points_mm(self) -> FloatArray:
        """Corners of the flat board (N, 2)."""
        y, x = np.mgrid[: self.rows, : self.columns] * self.square_mm
        return np.column_stack((x.ravel(), y.ravel()))

    def see(self, camera, turn, shift_mm, noise_px, random):
        """Return the pixels of the corners of the board, turned (3, 3) about its middle, and that put at a place."""
        half = 0.5 * self.square_mm * np.array([self.columns - 1, self.rows - 1])
        flat = self.points_mm - half
        bent = np.column_stack((flat, -self.height_mm(*(flat / half).T)))
        seen = camera.project(bent @ turn.T + np.asarray(shift_mm, dtype=float))
        return seen + random.normal(0.0, noise_px, seen.shape)

    def see_often(
        self, camera: Camera, count: int, seed: object, noise_px: float = 0.15, tilt_deg: float = 45.0
    ) -> list[FloatArray]:
        """Return the pixels of the corners in so many random poses in which the whole board is seen."""
        random = np.random.default_rng(seed)  # type: ignore[arg-type]
        views: list[FloatArray] = []
        while len(views) < count:
            way, tilt = random.uniform((0.0, 0.0), (2.0 * np.pi, np.deg2rad(tilt_deg)))
            back = turn_about(0.0, 0.0, random.normal(0.0, 0.2) - way)
            turn = turn_about(0.0, 0.0, way) @ turn_about(tilt) @ back
            shift = self.square_mm * self.columns * random.uniform((-0.4, -0.25, 1.0), (0.4, 0.25, 1.8))
            seen = self.see(camera, turn, shift, noise_px, random)
            if (seen > 5.0).all() and (seen < np.array(camera.size) - 5.0).all():
                views.append(seen)
        return views


def bend_board(row_mm: float, column_mm: float) -> Board:
    """Return a board whose middle stands so far above the ends of its middle row and column."""
    return Board(height_mm=lambda x, y: row_mm * (1.0 - x**2) + column_mm * (1.0 - y**2))


def turn_about(x_rad: float, y_rad: float = 0.0, z_rad: float = 0.0) -> FloatArray:
    """Return the rotation (3, 3) about a vector of this length."""
    return np.asarray(cv2.Rodrigues(np.array([x_rad, y_rad, z_rad]))[0])
