"""Pictures of a round needle lit from one side, drawn with a known radius.

Independent of `labrig` and of every other renderer here: numpy and OpenCV alone. The needle is a cylinder whose
brightness follows its surface: ambient light, Lambert's cosine of a lamp beside it, and the lamp's glint. So one
edge is brighter than the other, and the gel behind the needle lies in its shadow. Pixels at an edge are sampled
four by four; a point-spread function with a halo blurs the picture as turbid gel does. The insertion points right;
places are mm, columns (z, y) from the picture's upper left corner, z along the insertion and y down the picture.
"""

from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
Light = Literal[
    "even", "lamp inside the bend", "lamp outside the bend", "lamp along the needle", "shaded across"
]

# Samples along each side of a pixel, and how far from the centre line they are taken, in sheath diameters.
_SAMPLES = 4
_REACH = 0.6
_BEVEL = 1.5
_HALO_PX = 5.0
# Half width of the bright line, over half the needle's diameter.
_LINE = 0.12


@dataclass(frozen=True)
class SideLitNeedle:
    """A straight sheath up to `entry_mm`, and a needle that leaves it on an arc; positive bends go down the picture.

    `lamp_rad` is the direction towards the lamp in the picture, from +z towards +y (down), and `lamp` its brightness on
    a surface that faces it; `height` is the sine of its elevation above the picture. All levels are grey values.
    `shading` is by how many of them the steel is brighter at its lower edge than at its upper one, whatever the lamp
    does; `line` is the brightness of a thin line along it, `line_at` of the half width below its middle.
    """

    radius_mm: float
    length_mm: float
    entry_mm: tuple[float, float] = (15.0, 24.0)
    heading_rad: float = 0.0
    bend: int = 1
    diameter_mm: float = 1.2
    sheath_mm: float = 2.0
    px_per_mm: float = 10.0
    size_mm: tuple[float, float] = (87.0, 49.0)
    gel_level: float = 165.0
    gradient: tuple[float, float] = (0.1, 0.1)
    ambient: float = 50.0
    lamp: float = 0.0
    lamp_rad: float = 0.0
    height: float = 0.5
    glint: float = 0.0
    shadow: float = 0.0
    blur_px: float = 0.9
    halo: float = 0.05
    noise: float = 3.0
    shading: float = 0.0
    line: float = 0.0
    line_at: float = 0.0
    seed: int = 1

    def draw(self) -> NDArray[np.uint8]:
        """Return the picture (H, W)."""
        random = np.random.default_rng(self.seed)
        width, height = (round(side * self.px_per_mm) for side in self.size_mm)
        u, v = np.arange(width), np.arange(height)[:, None]
        slope, bulge = self.gradient
        away = (u / width - 0.5) * np.cos(self.lamp_rad) + (v / height - 0.5) * np.sin(self.lamp_rad)
        middle = (u / width - 0.5) ** 2 + (v / height - 0.5) ** 2
        image = self.gel_level * (1.0 + slope * away - bulge * middle)
        self._draw_shaft(image)
        narrow, wide = (
            cv2.GaussianBlur(image, (0, 0), sigma) for sigma in (self.blur_px, _HALO_PX * self.blur_px)
        )
        image = (1.0 - self.halo) * narrow + self.halo * wide
        image += random.normal(0.0, self.noise, image.shape)
        return np.clip(np.rint(image), 0, 255).astype(np.uint8)

    @property
    def centre_px(self) -> FloatArray:
        """The pixel (u, v) of the arc's centre."""
        away = self.bend * self.radius_mm
        aside = np.array([-np.sin(self.heading_rad), np.cos(self.heading_rad)])
        return np.asarray((self.entry_mm + away * aside) * self.px_per_mm - 0.5)

    @property
    def tip_px(self) -> FloatArray:
        """The pixel (u, v) of the end of the centre line, level with the foremost point of the bevel."""
        turn = self.bend * self.length_mm / self.radius_mm
        ahead = self.radius_mm * np.sin(abs(turn)) + 1j * self.bend * self.radius_mm * (1.0 - np.cos(turn))
        local = ahead * np.exp(1j * self.heading_rad)
        return np.asarray((self.entry_mm + np.array([local.real, local.imag])) * self.px_per_mm - 0.5)

    def _draw_shaft(self, image: FloatArray) -> None:
        """Draw needle, sheath and shadow where they are near, each pixel from the mean of its samples."""
        v, u = np.mgrid[: image.shape[0], : image.shape[1]]
        along, across, _ = self._locate(u, v)
        reach = self.sheath_mm * (_REACH + (self.shadow > 0.0))
        near = (np.abs(across) < reach) & (along < self.length_mm)
        rows, columns = np.nonzero(near)
        steps = (np.arange(_SAMPLES) + 0.5) / _SAMPLES - 0.5
        du, dv = (offsets.ravel() for offsets in np.meshgrid(steps, steps))
        along, across, normal_rad = self._locate(columns[:, None] + du, rows[:, None] + dv)
        gel = image[rows, columns][:, None] * (1.0 - self.shadow * self._shade(across, normal_rad))
        image[rows, columns] = np.where(
            self._covers(along, across), self._shine(along, across, normal_rad), gel
        ).mean(axis=1)

    def _locate(
        self, u: NDArray[np.number], v: NDArray[np.number]
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return arc length, distance across [mm], and the direction of growing distance [rad] of pixels."""
        z, y = (u + 0.5) / self.px_per_mm - self.entry_mm[0], (v + 0.5) / self.px_per_mm - self.entry_mm[1]
        local = (z + 1j * y) * np.exp(-1j * self.heading_rad)
        # The circle's centre lies at + i R for a needle that bends down, and at - i R otherwise.
        spoke = (local - 1j * self.bend * self.radius_mm) * (1j * self.bend)
        on_arc = (local.real > 0.0) & (np.angle(spoke) * self.bend > 0.0)
        turn = np.where(on_arc, np.angle(spoke), 0.0)
        along = np.where(on_arc, np.abs(turn) * self.radius_mm, local.real)
        across = np.where(on_arc, self.bend * (self.radius_mm - np.abs(spoke)), local.imag)
        return along, across, turn + self.heading_rad + 0.5 * np.pi

    def _half(self, along: FloatArray) -> FloatArray:
        return np.where(along > 0.0, 0.5 * self.diameter_mm, 0.5 * self.sheath_mm)

    def _covers(self, along: FloatArray, across: FloatArray) -> NDArray[np.bool_]:
        half = self._half(along)
        end = self.length_mm - _BEVEL * (across + half) * (along > 0.0)
        return np.asarray((np.abs(across) < half) & (along < end))

    def _shine(self, along: FloatArray, across: FloatArray, normal_rad: FloatArray) -> FloatArray:
        """Return the grey level of the cylinder's surface (Lambert's cosine law, and Blinn's glint)."""
        aside = np.clip(across / self._half(along), -1.0, 1.0)
        up = np.sqrt(1.0 - aside**2)
        flat = np.sqrt(1.0 - self.height**2) * np.cos(self.lamp_rad - normal_rad)
        lit = np.maximum(aside * flat + up * self.height, 0.0)
        # Half way between the lamp and the camera, which looks straight down.
        halfway = np.sqrt(2.0 + 2.0 * self.height)
        mirrored = np.maximum((aside * flat + up * (1.0 + self.height)) / halfway, 0.0)
        own = 0.5 * self.shading * aside + self.line * (np.abs(aside - self.line_at) < _LINE)
        return self.ambient + self.lamp * lit + self.glint * mirrored**60 + own

    def _shade(self, across: FloatArray, normal_rad: FloatArray) -> FloatArray:
        """Return how much of the needle's soft shadow lies on the gel, from 0 to 1."""
        away = -np.cos(self.lamp_rad - normal_rad)
        return np.asarray(
            np.abs(away)
            * np.exp(-0.5 * ((across - 0.6 * self.diameter_mm * away) / (0.5 * self.diameter_mm)) ** 2)
        )


def draw_random_needle(seed: int, radii_mm: tuple[float, float], light: Light) -> SideLitNeedle:
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
    return SideLitNeedle(
        radius_mm,
        length_mm,
        entry_mm=(random.uniform(8.0, 18.0), 24.5 - 12.0 * bend + random.uniform(-3.0, 3.0)),
        heading_rad=heading_rad,
        bend=bend,
        px_per_mm=random.uniform(7.0, 14.0),
        gel_level=random.uniform(140.0, 185.0),
        gradient=(lit * random.uniform(0.0, 0.3), random.uniform(0.0, 0.2)),
        ambient=random.uniform(40.0, 65.0),
        lamp=lit * random.uniform(5.0, 35.0),
        lamp_rad=towards + random.uniform(-0.7, 0.7),
        height=random.uniform(0.2, 0.8),
        glint=lit * random.uniform(0.0, 80.0),
        shadow=lit * random.uniform(0.0, 0.06),
        blur_px=random.uniform(0.6, 1.3),
        halo=random.uniform(0.0, 0.1),
        noise=random.uniform(1.5, 5.0),
        shading=side * random.uniform(8.0, 16.0),
        line=abs(side) * random.uniform(20.0, 100.0),
        line_at=side * random.uniform(0.2, 0.5),
        seed=seed,
    )
