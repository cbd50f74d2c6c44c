"""Specimens: gel with its radii, bubbles and clouds, and the holes made in it.

A specimen has gel coordinates (lateral, z): a point of the gel is at y = lateral + position once the operator has
shifted the gel to that position.
"""

import math
from dataclasses import dataclass, field
from functools import cached_property

import cv2
import numpy as np

from labrig.errors import InputError
from labrig.simulation.description import (
    GELS_DESIGN_RADIUS_MM,
    GelDescription,
    LayerDescription,
    WorldDescription,
    stream,
)
from labrig.simulation.lens import Field32, Floats
from labrig.simulation.track import EVEN, Track, Unevenness, draw_unevenness

LAST_POSITION_MM = 240.0  # holes lie between 0 and here
_LATERAL_MM = (-LAST_POSITION_MM - 30.0, 50.0)  # the part that is visible from some hole
_Z_MM = (-20.0, 130.0)
_CLOUD_GRID_MM = 0.5


def interpolate_radius_mm(gels: tuple[GelDescription, ...], gelatin_percent: float) -> tuple[float, float]:
    """Return mean and standard deviation of the radius in a gel, interpolated between the described gels.

    Raises
    ------
    InputError
        For a gel softer or stiffer than every described gel.
    """
    percents = [gel.gelatin_percent for gel in gels]
    if not percents[0] <= gelatin_percent <= percents[-1]:
        asked, known = f"gelatin of {gelatin_percent:g} %", f"{percents[0]:g} to {percents[-1]:g} %"
        raise InputError(
            f"{asked} lies outside of what the simulated world describes, {known}",
            "a real rig has no such limit; below `world: gels:` of calibration/rig-simulated.yaml, or of --rig, add "
            f"such a line: - {{gelatin_percent: {gelatin_percent:g}, radius_mean_mm: 27, radius_sd_mm: 0.4}}",
        )
    mean = np.interp(gelatin_percent, percents, [gel.radius_mean_mm for gel in gels])
    sd = np.interp(gelatin_percent, percents, [gel.radius_sd_mm for gel in gels])
    return float(mean), float(sd)


def draw_needle_scale(world: WorldDescription, seed: int, needle_id: str | None) -> float:
    """Return the scale of a needle's radii: its own radius, drawn once, over the paper's 30 mm.

    A design's tolerance is a worst case, so the draw is uniform between its ends. Without a design the scale is 1.
    """
    design = world.needle.design
    if design is None:
        return 1.0
    radius_mm = stream(seed, "needle", needle_id).uniform(design.radius_low_mm, design.radius_high_mm)
    return float(radius_mm / GELS_DESIGN_RADIUS_MM)


@dataclass
class Hole:
    """A place where the sheath enters, what was drawn for it, and what has been cut there so far.

    number, position_mm : the operator's; radius_mm : of the needle's path; play_mm, heading_rad : of the sheath;
    x_mm, lean_rad : the same out of the plane; slip_fraction : share of the insertion by which the tip lags behind;
    layers : where the radius is scaled; patchiness (N,) : how dark the cut looks at each mm; unevenness : what disturbs
    the path; track : the needle's path, from the time the needle first left the sheath, with the linear axis at
    track_linear_mm; sheath_reach_mm : the linear axis' farthest position.
    """

    number: int | None
    position_mm: float
    radius_mm: float
    play_mm: float
    heading_rad: float
    patchiness: Field32
    unevenness: Unevenness = EVEN
    x_mm: float = 0.0
    lean_rad: float = 0.0
    slip_fraction: float = 0.0
    layers: tuple[LayerDescription, ...] = ()
    track: Track | None = None
    track_linear_mm: float = 0.0
    sheath_reach_mm: float = 0.0

    def sheath_point_mm(self, beyond_origin_mm: float) -> tuple[float, float, float]:
        """Return the point (x, y, z) of the sheath's axis this far beyond the plane's origin."""
        in_plane_mm = beyond_origin_mm * math.cos(self.lean_rad)
        y_mm = self.play_mm + in_plane_mm * math.sin(self.heading_rad)
        x_mm = self.x_mm + beyond_origin_mm * math.sin(self.lean_rad)
        return x_mm, y_mm, in_plane_mm * math.cos(self.heading_rad)


def make_empty_hole() -> Hole:
    """Return the hole of an empty bench: the needle goes straight and leaves no cut."""
    return Hole(None, 0.0, math.inf, 0.0, 0.0, np.zeros(1, np.float32))


@dataclass(frozen=True)
class Ball:
    """An obstacle cast into a gel: centre (x, y, z) in the steering plane's frame, and radius [mm]."""

    position_mm: tuple[float, float, float]
    radius_mm: float


@dataclass
class GelBlock:
    """A block of gel with its obstacles, and its holes by the operator's number and position.

    A phantom is a block for one insertion, in which obstacles may be cast. Its look is drawn, by seed and name, when a
    picture first shows it: most virtual insertions take none.
    """

    name: str
    gelatin_percent: float
    seed: int
    bubble_count: int
    obstacles: tuple[Ball, ...] = ()
    is_phantom: bool = False
    holes: dict[tuple[int | None, float], Hole] = field(default_factory=dict)

    @cached_property
    def bubbles(self) -> list[list[float]]:
        """Its air bubbles: centre in gel coordinates, lateral and z, and radius of each [mm]."""
        return _cast_bubbles(self.bubble_count, stream(self.seed, "bubbles", self.name))

    @cached_property
    def clouds(self) -> Field32:
        """Its relative brightness on a grid; the mean is 0."""
        return _cast_clouds(stream(self.seed, "clouds", self.name))

    def clouds_at(self, lateral_mm: Field32, z_mm: Field32) -> Field32:
        """Return the gel's relative brightness at gel coordinates (H, W); its mean is 0."""
        columns = (z_mm - np.float32(_Z_MM[0])) / np.float32(_CLOUD_GRID_MM)
        rows = (lateral_mm - np.float32(_LATERAL_MM[0])) / np.float32(_CLOUD_GRID_MM)
        clouds = cv2.remap(self.clouds, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
        return np.asarray(clouds, np.float32)


def cast_specimen(world: WorldDescription, seed: int, name: str, gelatin_percent: float) -> GelBlock:
    """Return a fresh specimen; the same name, gelatin and seed give the same one.

    Raises
    ------
    InputError
        For a gelatin that the world does not describe.
    """
    interpolate_radius_mm(world.gels, gelatin_percent)
    return GelBlock(name, gelatin_percent, seed, world.bubbles_per_specimen)


def make_hole(
    world: WorldDescription,
    seed: int,
    specimen: GelBlock,
    place: tuple[int | None, float],
    needle_id: str | None,
) -> Hole:
    """Return an unused hole at a place (number, position) with everything drawn for it and the needle."""
    purpose = (specimen.name, place[0], needle_id)
    random = stream(seed, "hole", *purpose)
    scale = draw_needle_scale(world, seed, needle_id)
    mean, sd = interpolate_radius_mm(world.gels, specimen.gelatin_percent)
    radius, play, angle = random.standard_normal(3).tolist()
    disturbed = specimen.is_phantom or world.disturbances.in_every_gel
    x, lean, slip = stream(seed, "out of plane and slip", *purpose).standard_normal(3).tolist()
    return Hole(
        *place,
        radius_mm=scale * (mean + sd * radius),
        play_mm=world.sheath.lateral_play_sd_mm * play,
        heading_rad=math.radians(world.sheath.angle_play_sd_deg * angle),
        patchiness=_draw_patchiness(random),
        unevenness=draw_unevenness(world.disturbances, stream(seed, "path", *purpose)) if disturbed else EVEN,
        x_mm=world.sheath.x_play_sd_mm * x,
        lean_rad=math.radians(world.sheath.lean_play_sd_deg * lean),
        slip_fraction=world.disturbances.slip_sd_fraction * abs(slip) if disturbed else 0.0,
        layers=world.layers if specimen.is_phantom else (),
    )


def _draw_patchiness(random: np.random.Generator) -> Field32:
    """Return the darkness of a cut at every millimetre: air stays in it only in places."""
    slow = np.convolve(random.standard_normal(128), np.ones(5) / math.sqrt(5), mode="same")
    return np.clip(0.075 + 0.05 * slow, 0.015, 0.20).astype(np.float32)


def _cast_bubbles(count: int, random: np.random.Generator) -> list[list[float]]:
    lateral = random.uniform(*_LATERAL_MM, count)
    z = random.uniform(-13.0, _Z_MM[1], count)
    radius = np.clip(random.lognormal(math.log(0.30), 0.55, count), 0.1, 1.0)
    rows: list[list[float]] = np.stack([lateral, z, radius], axis=1).tolist()
    return rows


def _cast_clouds(random: np.random.Generator) -> Field32:
    """Return the relative brightness of the gel on a grid: broad clouds and a finer grain."""
    shape = tuple(int((high - low) / _CLOUD_GRID_MM) for low, high in (_LATERAL_MM, _Z_MM))
    broad = _draw_smooth_noise(random, shape, 7.0 / _CLOUD_GRID_MM) * 0.030
    fine = _draw_smooth_noise(random, shape, 0.9 / _CLOUD_GRID_MM) * 0.008
    return (broad + fine).astype(np.float32)


def _draw_smooth_noise(random: np.random.Generator, shape: tuple[int, ...], sigma: float) -> Floats:
    """Return Gaussian noise of unit standard deviation, correlated over `sigma` samples."""
    noise = np.asarray(cv2.GaussianBlur(random.standard_normal(shape), (0, 0), sigma), np.float64)
    smooth: Floats = noise / noise.std()
    return smooth
