"""Pictures of a needle and what may stand beside, before or across it, drawn with known ends.

Independent of `labrig.simulation` and of every other renderer here: numpy and OpenCV alone, no lens, no plane map. A
pixel at an edge is covered in part, then the picture is blurred. The insertion points right; places are mm, columns
(z, y) from the picture's upper left corner, z along the insertion and y down the picture.
"""

from dataclasses import dataclass, field
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
Background = Literal["gel", "bright table", "dark table", "holder"]


@dataclass(frozen=True)
class SceneNeedle:
    """A sheath, straight from far outside up to `tip_mm`, and a needle that leaves it on an arc.

    A curvature of zero is a straight needle. `sheath_ratio` is None where the needle has no sheath.
    """

    sheath_tip_mm: tuple[float, float] = (15.0, 24.0)
    heading_rad: float = 0.0
    curvature_per_mm: float = 1.0 / 40.0
    length_mm: float = 40.0
    diameter_mm: float = 1.2
    sheath_ratio: float | None = 5.0 / 3.0
    level: float = 60.0
    glint: float = 0.6
    bevel_mm: float = 1.8

    def path_mm(self, s: FloatArray) -> FloatArray:
        """Return the points (N, 2) of the centre line at arc lengths `s` (N,) from the sheath's tip."""
        k = self.curvature_per_mm or 1e-9
        turn = np.where(s > 0.0, k * s, 0.0)
        along = np.where(s > 0.0, np.sin(turn) / k, s)
        across = np.where(s > 0.0, (1.0 - np.cos(turn)) / k, 0.0)
        c, n = np.cos(self.heading_rad), np.sin(self.heading_rad)
        z, y = self.sheath_tip_mm
        return np.column_stack((z + along * c - across * n, y + along * n + across * c))

    @property
    def tip_mm(self) -> tuple[float, float]:
        """Return the end of the centre line."""
        z, y = self.path_mm(np.array([self.length_mm]))[0]
        return float(z), float(y)

    def along_across(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return arc length and signed distance from the centre line of points (..., 2)."""
        c, n = np.cos(self.heading_rad), np.sin(self.heading_rad)
        dz, dy = points[..., 0] - self.sheath_tip_mm[0], points[..., 1] - self.sheath_tip_mm[1]
        along, across = dz * c + dy * n, dy * c - dz * n
        k = self.curvature_per_mm or 1e-9
        turn = np.arctan2(along, (1.0 / k - across) * np.sign(k))
        on_arc = (along > 0.0) & (turn > 0.0)
        radius = np.hypot(along, 1.0 / k - across)
        return (
            np.where(on_arc, turn / abs(k), along),
            np.where(on_arc, (1.0 / abs(k) - radius) * np.sign(k), across),
        )


@dataclass(frozen=True)
class SceneBar:
    """A straight bar: a wall (bright or dark), a wire, a scratch. It is centred at `centre_mm`.

    `opacity` is how much of what lies below it the bar hides.
    """

    centre_mm: tuple[float, float]
    angle_rad: float
    width_mm: float
    level: float
    opacity: float = 1.0
    length_mm: float = 1000.0
    soft_mm: float = 0.0


@dataclass(frozen=True)
class Scene:
    """What the picture shows.

    `edge_mm` is where the gel begins (0: gel everywhere); before it lies `before`. A "holder" is a dark block that
    hides the sheath up to the edge. On a "dark table" the sheath cannot be told from the table.
    """

    needle: SceneNeedle | None
    width_px: int = 960
    height_px: int = 540
    px_per_mm: float = 11.0
    gel_level: float = 165.0
    unevenness: float = 0.25
    blur_px: float = 0.9
    noise: float = 3.0
    edge_mm: float = 0.0
    edge_rad: float = 0.0
    before: Background = "gel"
    below: tuple[SceneBar, ...] = field(default=())
    above: tuple[SceneBar, ...] = field(default=())
    others: tuple[SceneNeedle, ...] = field(default=())
    bubbles: int = 12
    tracks: int = 2
    seed: int = 1

    def draw(self) -> NDArray[np.uint8]:
        """Return the picture (H, W)."""
        random = np.random.default_rng(self.seed)
        v, u = np.mgrid[: self.height_px, : self.width_px]
        points = (np.stack((u, v), axis=-1) + 0.5) / self.px_per_mm
        image = np.full(u.shape, self.gel_level)
        self._draw_tracks(image, points, random)
        self._draw_bubbles(image, points, random)
        image *= self._light(random)
        beyond = self._beyond_edge(points)
        if self.before != "gel":
            level = {"bright table": 225.0, "dark table": 45.0, "holder": 215.0}[self.before]
            image = beyond * image + (1.0 - beyond) * (level + random.normal(0.0, 2.0))
        for bar in self.below:
            self._draw_bar(image, points, bar)
        for needle in (*self.others, *((self.needle,) if self.needle else ())):
            self._draw_needle(image, points, needle)
        if self.before == "dark table":
            image = beyond * image + (1.0 - beyond) * np.minimum(image, 47.0)
        if self.before == "holder":
            self._draw_holder(image, points, beyond)
        for bar in self.above:
            self._draw_bar(image, points, bar)
        image = cv2.GaussianBlur(image, (0, 0), self.blur_px)
        image = image + random.normal(0.0, self.noise, image.shape)
        return np.clip(np.rint(image), 0, 255).astype(np.uint8)

    def px(self, places_mm: FloatArray) -> FloatArray:
        """Return pixels (u, v) of places (N, 2) [mm]."""
        return np.asarray(places_mm) * self.px_per_mm - 0.5

    def _cover(self, inside_mm: FloatArray, soft_mm: float = 0.0) -> FloatArray:
        """Return how much (0 to 1) of a pixel lies inside an edge that is `inside_mm` away."""
        return np.clip(0.5 + inside_mm / max(1.0 / self.px_per_mm, soft_mm), 0.0, 1.0)

    def _beyond_edge(self, points: FloatArray) -> FloatArray:
        middle = self.height_px / self.px_per_mm / 2.0
        return self._cover(points[..., 0] - self.edge_mm - (points[..., 1] - middle) * np.tan(self.edge_rad))

    def _light(self, random: np.random.Generator) -> FloatArray:
        v, u = np.mgrid[: self.height_px, : self.width_px]
        x, y = u / self.width_px - 0.5, v / self.width_px - 0.5
        angle = random.uniform(0.0, 2.0 * np.pi)
        return np.asarray(
            1.0 - self.unevenness * (np.cos(angle) * x + np.sin(angle) * y + 0.8 * (x * x + y * y))
        )

    def _draw_needle(self, image: FloatArray, points: FloatArray, needle: SceneNeedle) -> None:
        along, across = needle.along_across(points)
        half = 0.5 * needle.diameter_mm
        # The bevel narrows from one side and its flank reflects, so the darkness fades along it.
        near_tip = np.clip((along - needle.length_mm + needle.bevel_mm) / needle.bevel_mm, 0.0, 1.0)
        body = self._cover(half - across) * self._cover(half + across - near_tip * 1.7 * half)
        body *= self._cover(needle.length_mm - along) * (1.0 - 0.35 * near_tip)
        round_ = np.clip(np.abs(across) / half, 0.0, 1.0) ** 4
        image += body * (needle.level - 8.0 * (1.0 - round_) - image)
        stripe = np.exp(-0.5 * ((across + 0.2 * half) / (0.16 * half)) ** 2)
        image += body * (1.0 - near_tip) * needle.glint * stripe * (230.0 - image)
        if needle.sheath_ratio is not None:
            wide = half * needle.sheath_ratio
            sheath = self._cover(wide - np.abs(across)) * self._cover(-along)
            image += sheath * (needle.level + 8.0 - image)
            stripe = np.exp(-0.5 * ((across + 0.3 * wide) / (0.12 * wide)) ** 2)
            image += sheath * needle.glint * stripe * (230.0 - image)

    def _draw_bar(self, image: FloatArray, points: FloatArray, bar: SceneBar) -> None:
        dz, dy = points[..., 0] - bar.centre_mm[0], points[..., 1] - bar.centre_mm[1]
        along = dz * np.cos(bar.angle_rad) + dy * np.sin(bar.angle_rad)
        across = dy * np.cos(bar.angle_rad) - dz * np.sin(bar.angle_rad)
        cover = self._cover(bar.width_mm / 2.0 - np.abs(across), bar.soft_mm)
        cover *= self._cover(bar.length_mm / 2.0 - np.abs(along)) * bar.opacity
        image += cover * (bar.level - image)

    def _draw_holder(self, image: FloatArray, points: FloatArray, beyond: FloatArray) -> None:
        centre = self.needle.sheath_tip_mm[1] if self.needle else 20.0
        block = (1.0 - beyond) * self._cover(9.0 - np.abs(points[..., 1] - centre))
        image += block * (50.0 - image)

    def _draw_tracks(self, image: FloatArray, points: FloatArray, random: np.random.Generator) -> None:
        """Draw faint courses of earlier needles."""
        start, middle = (self.edge_mm + 8.0, self.height_px / self.px_per_mm / 2.0)
        for _ in range(self.tracks):
            place = (start, middle + random.uniform(-0.8, 0.8) * middle)
            track = SceneNeedle(
                place, random.normal(0.0, 0.05), random.uniform(-0.03, 0.03), random.uniform(20.0, 45.0)
            )
            along, across = track.along_across(points)
            cover = np.exp(-0.5 * (across / random.uniform(0.15, 0.3)) ** 2)
            image -= cover * ((along > -start) & (along < track.length_mm)) * random.uniform(8.0, 20.0)

    def _draw_bubbles(self, image: FloatArray, points: FloatArray, random: np.random.Generator) -> None:
        extent = np.array([self.width_px, self.height_px]) / self.px_per_mm
        for _ in range(self.bubbles):
            radius, centre = random.uniform(0.2, 0.7), random.uniform((0.0, 0.0), extent)
            (left, top), (right, bottom) = (
                np.maximum((centre + side) * self.px_per_mm, 0.0).astype(int) for side in (-1.0, 1.0)
            )
            box = np.s_[top : bottom + 1, left : right + 1]
            away = np.hypot(*np.moveaxis(points[box] - centre, -1, 0))
            image[box] += np.exp(-0.5 * ((away - radius) / 0.08) ** 2) * float(random.choice((-35.0, 35.0)))
