"""Pictures of a needle with a known arc, drawn by this room's tests alone.

Independent of `labrig.simulation`, which other rooms' tests use: a mistake that two renderers share would hide in
both. Every pixel is sent through lens and plane to mm by OpenCV's own model, and the needle is drawn there by its
distance from the centre line.
"""

from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from labrig.vision.intrinsics import Intrinsics
from labrig.vision.plane import PlaneMap

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class RenderedLens:
    """A pinhole camera with radial distortion before a plane that may lean."""

    width: int = 1280
    height: int = 720
    focal_px: float = 1800.0
    centre_px: tuple[float, float] = (645.0, 352.0)
    k1: float = -0.12
    k2: float = 0.05
    distance_mm: float = 115.4
    tilt_rad: float = np.deg2rad(2.0)
    origin_px: tuple[float, float] = (320.0, 200.0)

    @property
    def matrix(self) -> FloatArray:
        """Camera matrix (3, 3)."""
        f, (cx, cy) = self.focal_px, self.centre_px
        return np.array([[f, 0.0, cx], [0.0, f, cy], [0.0, 0.0, 1.0]])

    @property
    def distortion(self) -> FloatArray:
        """k1, k2, p1, p2, k3."""
        return np.array([self.k1, self.k2, 0.0, 0.0, 0.0])

    def plane_to_ideal(self) -> FloatArray:
        """Return the homography (3, 3) from (y, z, 1) mm to undistorted pixels; insertion to the right."""
        axis = np.array([0.3, 1.0, 0.0]) / np.hypot(0.3, 1.0)
        tilt = cv2.Rodrigues(axis * self.tilt_rad)[0]
        to_camera = np.column_stack(
            (tilt @ [0.0, -1.0, 0.0], tilt @ [1.0, 0.0, 0.0], [0.0, 0.0, self.distance_mm])
        )
        h = self.matrix @ to_camera
        ideal = cv2.undistortPoints(
            np.array([[self.origin_px]]), self.matrix, self.distortion, P=self.matrix
        )[0, 0]
        start = np.linalg.solve(h, [*ideal, 1.0])
        y, z = start[:2] / start[2]
        return np.asarray(h @ np.array([[1.0, 0.0, y], [0.0, 1.0, z], [0.0, 0.0, 1.0]]))

    def plane_map(self) -> PlaneMap:
        """Return the exact map, as a perfect calibration would."""
        k1, k2, p1, p2, k3 = map(float, self.distortion)
        k, size, (cx, cy) = (k1, k2, p1, p2, k3), (self.width, self.height), self.centre_px
        none: dict[str, float | None] = dict.fromkeys(("fx", "fy", "cx", "cy"))
        intrinsics = Intrinsics(size, self.focal_px, self.focal_px, cx, cy, k, none, 0.0, None, (), True, ())
        to_mm = np.asarray(np.linalg.inv(self.plane_to_ideal()), np.float64)
        return PlaneMap(
            homography=to_mm,
            intrinsics=intrinsics,
            origin_px=self.origin_px,
            insertion="right",
            image_size=size,
            mm_per_px=self.distance_mm / self.focal_px,
        )

    def pixels_mm(self) -> FloatArray:
        """Return the plane point (H, W, 2), columns (y, z) mm, that each pixel sees."""
        v, u = np.mgrid[: self.height, : self.width].astype(np.float64)
        px = np.stack((u, v), axis=-1).reshape(-1, 1, 2)
        criteria = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 30, 1e-9)
        ideal = cv2.undistortPointsIter(px, self.matrix, self.distortion, None, self.matrix, criteria)
        mm = cv2.perspectiveTransform(ideal, np.linalg.inv(self.plane_to_ideal()))
        return np.asarray(mm, np.float64).reshape(self.height, self.width, 2)


@dataclass(frozen=True)
class RenderedNeedle:
    """What stands in the gel; a negative length leaves the needle inside its sheath."""

    radius_mm: float = 28.0
    length_mm: float = 40.0
    ramp_mm: float = 3.0
    diameter_mm: float = 1.2
    sheath_diameter_mm: float = 2.0
    sheath_tip_mm: tuple[float, float] = (0.0, 0.0)
    heading_rad: float = 0.0
    bend: int = -1
    bevel_rad: float = np.deg2rad(35.0)
    glint: float = 1.0

    def centre_line(self, step_mm: float = 0.01) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return arc length (N,), points (N, 2) mm and headings (N,) from the sheath's tip on."""
        s = np.arange(0.0, max(self.length_mm, 1.0) + step_mm, step_mm)
        kappa = self.bend / self.radius_mm * np.clip(s / max(self.ramp_mm, 1e-9), 0.0, 1.0)
        heading = self.heading_rad + np.concatenate(
            ([0.0], np.cumsum(0.5 * (kappa[1:] + kappa[:-1]) * step_mm))
        )
        middle = 0.5 * (heading[1:] + heading[:-1])
        moves = np.column_stack((np.sin(middle), np.cos(middle))) * step_mm
        points = np.vstack(([0.0, 0.0], np.cumsum(moves, axis=0))) + self.sheath_tip_mm
        return s, points, heading


@dataclass(frozen=True)
class RenderedGel:
    """What else the picture shows."""

    level: float = 165.0
    needle_level: float = 62.0
    sheath_level: float = 70.0
    glint_level: float = 225.0
    unevenness: float = 0.3
    bubbles: int = 25
    tracks_mm: tuple[float, ...] = (10.0, 20.0, -10.0)
    blur_px: float = 0.8
    noise: float = 3.0
    extra: tuple[RenderedNeedle, ...] = field(default=())


class RenderedBench:
    """A lens looking at a gel; draws any number of pictures."""

    def __init__(self, lens: RenderedLens) -> None:
        self.lens = lens
        self.mm = lens.pixels_mm()
        self.px_per_mm = 1.0 / float(np.median(np.hypot(*np.moveaxis(np.diff(self.mm, axis=1), -1, 0))))

    def picture(self, needle: RenderedNeedle | None, gel: RenderedGel, seed: int) -> NDArray[np.uint8]:
        """Return the picture (H, W) of `needle` (None: neither needle nor sheath) in `gel`."""
        random = np.random.default_rng(seed)
        image = np.full(self.mm.shape[:2], gel.level)
        model = needle or RenderedNeedle()
        for offset in gel.tracks_mm:
            self._track(image, model, offset, random)
        self._bubbles(image, gel, random)
        for shaft in (*gel.extra, *([needle] if needle else [])):
            self._shaft(image, shaft, gel)
        image *= self._light(gel, random)
        image = cv2.GaussianBlur(image, (0, 0), gel.blur_px) if gel.blur_px else image
        image += random.normal(0.0, gel.noise, image.shape) if gel.noise else 0.0
        return np.clip(np.rint(image), 0, 255).astype(np.uint8)

    def _light(self, gel: RenderedGel, random: np.random.Generator) -> FloatArray:
        h, w = self.mm.shape[:2]
        v, u = np.mgrid[:h, :w]
        x, y = (u - w / 2) / (w / 2), (v - h / 2) / (w / 2)
        angle = random.uniform(0, 2 * np.pi)
        slope = np.cos(angle) * x + np.sin(angle) * y
        return np.asarray(1.0 - gel.unevenness * (0.5 * (x * x + y * y) + 0.5 * slope))

    def _blend(
        self, image: FloatArray, where: tuple[NDArray[np.intp], ...], cover: FloatArray, level: float
    ) -> None:
        image[where] = image[where] * (1.0 - cover) + level * cover

    def _shaft(self, image: FloatArray, needle: RenderedNeedle, gel: RenderedGel) -> None:
        s, points, heading = needle.centre_line()
        back = points[0] - np.outer(
            np.arange(0.02, 80.0, 0.02)[::-1], [np.sin(heading[0]), np.cos(heading[0])]
        )
        where, along, across = self._along_across(
            np.vstack((back, points)),
            np.concatenate((np.full(len(back), heading[0]), heading)),
            np.concatenate((-np.arange(0.02, 80.0, 0.02)[::-1], s)),
        )
        cover = self._bar(across, needle.diameter_mm)
        end = needle.length_mm - (across * needle.bend + needle.diameter_mm / 2) / np.tan(needle.bevel_rad)
        cover *= np.clip(0.5 + (end - along) * np.sin(needle.bevel_rad) * self.px_per_mm, 0.0, 1.0)
        self._blend(image, where, cover, gel.needle_level)
        stripe = self._bar(across - 0.2 * needle.diameter_mm, 0.12 * needle.diameter_mm)
        self._blend(image, where, cover * stripe * needle.glint, gel.glint_level)
        sheath = self._bar(across, needle.sheath_diameter_mm) * np.clip(
            0.5 - along * self.px_per_mm, 0.0, 1.0
        )
        self._blend(image, where, sheath, gel.sheath_level)

    def _bar(self, across: FloatArray, width_mm: float) -> FloatArray:
        return np.clip(0.5 + (width_mm / 2 - np.abs(across)) * self.px_per_mm, 0.0, 1.0)

    def _along_across(
        self, points: FloatArray, heading: FloatArray, s: FloatArray, reach_mm: float = 2.5
    ) -> tuple[tuple[NDArray[np.intp], ...], FloatArray, FloatArray]:
        near = self._near(points, reach_mm)
        where = np.nonzero(near)
        mm = self.mm[where]
        distance, index = cKDTree(points[::4]).query(mm, distance_upper_bound=reach_mm)
        kept = np.isfinite(distance)
        where = tuple(axis[kept] for axis in where)
        index, mm = np.asarray(index)[kept] * 4, mm[kept]
        offset = mm - points[index]
        tangent = np.column_stack((np.sin(heading[index]), np.cos(heading[index])))
        along = np.sum(offset * tangent, axis=1)
        turn = np.gradient(heading, s)[index]
        across = offset[:, 0] * tangent[:, 1] - offset[:, 1] * tangent[:, 0]
        across = across - 0.5 * turn * along**2
        return where, s[index] + along / (1.0 - turn * across), across

    def _near(self, points: FloatArray, reach_mm: float) -> NDArray[np.bool_]:
        mask = np.zeros(self.mm.shape[:2], np.uint8)
        cv2.polylines(mask, [self._to_px(points[::10])], False, 1, int(2 * reach_mm * self.px_per_mm) + 1)
        return mask.astype(bool)

    def _to_px(self, mm: FloatArray) -> NDArray[np.int32]:
        ideal = cv2.perspectiveTransform(mm.reshape(-1, 1, 2), self.lens.plane_to_ideal())
        rays = np.column_stack((ideal[:, 0], np.ones(len(ideal)))) @ np.linalg.inv(self.lens.matrix).T
        px = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), self.lens.matrix, self.lens.distortion)[0]
        return np.clip(np.rint(px[:, 0]), -20000, 20000).astype(np.int32)

    def _track(
        self, image: FloatArray, needle: RenderedNeedle, offset_mm: float, random: np.random.Generator
    ) -> None:
        radius = needle.radius_mm + random.normal(0.0, 0.5)
        shape = RenderedNeedle(
            radius, 40.0, sheath_tip_mm=(offset_mm, 0.0), bend=needle.bend, bevel_rad=needle.bevel_rad
        )
        points = self._to_px(shape.centre_line()[1][::20])
        mask = np.zeros(image.shape, np.uint8)
        width = max(1, int(random.uniform(0.3, 0.6) * self.px_per_mm))
        cv2.polylines(mask, [points], False, 255, width, cv2.LINE_AA)
        image -= cv2.GaussianBlur(mask, (0, 0), 1.0).astype(np.float64) / 255.0 * random.uniform(15.0, 25.0)

    def _bubbles(self, image: FloatArray, gel: RenderedGel, random: np.random.Generator) -> None:
        h, w = image.shape
        for _ in range(gel.bubbles):
            centre = (int(random.uniform(0, w)), int(random.uniform(0, h)))
            radius = int(random.uniform(0.2, 0.6) * self.px_per_mm)
            ring = np.zeros(image.shape, np.uint8)
            cv2.circle(ring, centre, radius, 255, 2, cv2.LINE_AA)
            image += ring * (random.choice((-30.0, 30.0)) / 255.0)
