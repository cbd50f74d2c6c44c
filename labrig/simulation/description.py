"""The simulated world: the `world:` section of a rig file, and the streams of its random draws."""

import hashlib
from collections.abc import Iterable
from itertools import pairwise
from typing import Annotated

import numpy as np
from pydantic import Field

from labrig.protocol.model import (
    Conflict,
    Interval,
    MarkerDictionary,
    MarkerId,
    Model,
    NonNegativeMm,
    PixelUv,
    PositiveMm,
)


class GelDescription(Model):
    """How tightly the needle steers in a gel: each insertion draws its radius normally distributed."""

    gelatin_percent: Annotated[float, Field(gt=0, le=100)]
    """Mass of gelatin powder over mass of water [%]."""
    radius_mean_mm: PositiveMm
    """Mean radius of curvature [mm]."""
    radius_sd_mm: NonNegativeMm
    """Standard deviation of the radius between insertions [mm]."""


GELS_DESIGN_RADIUS_MM = 30.0
"""Design radius of the paper's needle, to which the gels' radii apply."""


class DesignDescription(Model):
    """What a needle was designed for: its hinges let it steer at some radius within the tolerance."""

    radius_low_mm: PositiveMm
    """Smallest radius by the laser's tolerances and the fit's error [mm]."""
    radius_high_mm: PositiveMm
    """Largest radius by the laser's tolerances and the fit's error [mm]."""


class NeedleDescription(Model):
    """The needle as it is, not as it was designed."""

    diameter_mm: Annotated[float, Field(gt=0, le=2.5)] = 1.2
    """Outer diameter [mm]."""
    hinge_closing_mm: PositiveMm = 3.0
    """Arc length over which the hinges close: curvature grows linearly from 0 to 1/r [mm]."""
    backlash_mm: PositiveMm = 1.5
    """Insertion after half a turn of the bevel in which the play of the hinges lets the curvature swing over
    to the other side [mm]."""
    clamp_roll_deg: Annotated[float, Field(ge=-180, le=180)] = 0.0
    """Roll of the bevel where the rotation axis stands at zero: how the needle is clamped [deg]."""
    bevel_deg: Annotated[float, Field(ge=15, le=90)] = 50.0
    """Angle between the bevel's face and the needle's axis [deg]."""
    link_mm: PositiveMm = 3.0
    """Length of a link between two hinges; each cut shows as a tick [mm]."""
    torsion_lag_deg: Annotated[float, Field(ge=0, le=90)] = 0.0
    """Torsional play: the bevel follows the rotation axis only when it is this far behind, in each direction,
    and stays behind until the axis turns back [deg]."""
    torsion_lag_deg_per_mm: Annotated[float, Field(ge=0, le=5)] = 0.0
    """What friction adds to the play for each millimetre of needle in the gel [deg/mm]."""
    design: DesignDescription | None = None
    """What the needle was designed for; each needle draws its radius in between, and the gels' radii are
    scaled by it over 30 mm. null: the gels' radii as they are, or what the protocol's design file says."""


class SheathDescription(Model):
    """The straight tube that leads the needle into the gel."""

    diameter_mm: Annotated[float, Field(gt=0, le=3)] = 2.0
    """Outer diameter [mm]."""
    lateral_play_sd_mm: NonNegativeMm = 0.05
    """Standard deviation, from hole to hole, of the tip's lateral position [mm]."""
    angle_play_sd_deg: Annotated[float, Field(ge=0, le=10)] = 0.2
    """Standard deviation, from hole to hole, of the direction of entry [deg]."""
    x_play_sd_mm: NonNegativeMm = 0.0
    """Standard deviation, from hole to hole, of the tip's distance from the steering plane [mm]."""
    lean_play_sd_deg: Annotated[float, Field(ge=0, le=10)] = 0.0
    """Standard deviation, from hole to hole, of the angle of entry out of the plane [deg]."""


class LensDescription(Model):
    """The camera: pinhole, Brown-Conrady distortion, and how it stands over the steering plane."""

    width_px: Annotated[int, Field(ge=64, le=4096)] = 1280
    """Width of the picture [px]."""
    height_px: Annotated[int, Field(ge=64, le=4096)] = 720
    """Height of the picture [px]."""
    fx_px: Annotated[float, Field(gt=0)] = 1800.0
    """Focal length along u [px]."""
    fy_px: Annotated[float, Field(gt=0)] = 1802.0
    """Focal length along v [px]."""
    cx_px: float = 645.0
    """Principal point, u [px]."""
    cy_px: float = 352.0
    """Principal point, v [px]."""
    distortion: tuple[float, float, float, float, float] = (-0.12, 0.05, 0.0006, -0.0004, 0.0)
    """k1, k2, p1, p2, k3 [-]."""
    distance_mm: PositiveMm = 115.0
    """From the centre of projection to the steering plane, along the optical axis [mm]."""
    tilt_deg: Annotated[float, Field(ge=0, le=30)] = 2.0
    """Angle between the optical axis and the plane's normal [deg]."""
    tilt_azimuth_deg: float = 35.0
    """Axis in the picture about which the camera is tilted, from u towards v [deg]."""
    roll_deg: float = 0.4
    """Turn of the camera about its optical axis [deg]."""
    origin_px: PixelUv = (320.0, 200.0)
    """Where the origin of the steering plane stands in the picture, (u, v) [px]."""


class LightDescription(Model):
    """The light table under the gel and the lamp above it."""

    level: Annotated[float, Field(gt=0, le=255)] = 165.0
    """Brightness of clear gel [grey]."""
    unevenness: Annotated[float, Field(ge=0, le=1)] = 0.3
    """Fall of brightness across the picture [fraction of level]."""
    glint: Annotated[float, Field(ge=0, le=255)] = 150.0
    """Brightness that the needle's specular glint adds [grey]."""
    azimuth_deg: float = 115.0
    """Where the lamp stands, from +z towards +y in the steering plane [deg]."""


class DisturbancesDescription(Model):
    """What keeps a needle from its arcs. Each path draws its own."""

    in_every_gel: bool = False
    """Whether plain blocks of gel are disturbed too. false: phantoms only, because the gels' standard
    deviations, which are the paper's, hold what disturbed its sweep."""
    heading_deg_per_root_mm: Annotated[float, Field(ge=0, le=10)] = 0.3
    """Standard deviation of the heading in the plane after a millimetre [deg / mm^0.5]."""
    out_of_plane_deg_per_root_mm: Annotated[float, Field(ge=0, le=10)] = 0.0
    """The same out of the plane, which the camera does not see [deg / mm^0.5]."""
    curvature_fraction: Annotated[float, Field(ge=0, le=0.3)] = 0.03
    """Standard deviation of the curvature along the path over its mean [-]."""
    curvature_length_mm: PositiveMm = 10.0
    """Length after which the curvature has forgotten its deviation [mm]."""
    cavities: Annotated[int, Field(ge=0, le=20)] = 0
    """Cavities in each path, in which the needle does not steer [-]."""
    cavity_mm: Interval = (6.0, 10.0)
    """Shortest and longest cavity [mm]."""
    slip_sd_fraction: Annotated[float, Field(ge=0, le=0.1)] = 0.0
    """Share of the inserted length by which the tip lags behind, because needle and gel give way: the size of
    a normal draw with this standard deviation, once for a hole [-]."""


class LayerDescription(Model):
    """A layer of a phantom in which the needle steers at another radius than in the rest of the gel."""

    until_mm: PositiveMm
    """Where the layer ends, along z from the origin of the steering plane [mm]."""
    radius_scale: Annotated[float, Field(gt=0, le=10)]
    """Radius in the layer over the radius drawn for the gel [-]."""


class PrintedMarkerDescription(Model):
    """A printed marker on the gel of a phantom, which moves with the target."""

    marker_id: MarkerId
    """Its id in the dictionary."""
    dictionary: MarkerDictionary = "DICT_4X4_50"
    """OpenCV's name of its dictionary."""
    side_mm: PositiveMm
    """Side of its black square; a white rim a bit wide is around it [mm]."""
    position_mm: tuple[float, float]
    """Where its centre is before the target moves, y and z [mm]."""
    x_mm: Annotated[float, Field(ge=-100, le=100)] = 0.0
    """Where it is across the steering plane, positive away from the camera [mm]."""
    turn_deg: float = 0.0
    """How it is turned in the plane, from +z towards +y [deg]."""
    covered_mm: Interval | None = None
    """Lengths of the needle's path between which something covers it; null: nothing does [mm]."""


def _paper_gels() -> tuple[GelDescription, ...]:
    """Return the radii of the paper's section V-B."""
    rows = ((10, 28.34, 0.247), (13, 27.71, 0.237), (16, 27.36, 0.459), (19, 27.13, 0.473))
    return tuple(GelDescription(gelatin_percent=p, radius_mean_mm=m, radius_sd_mm=s) for p, m, s in rows)


class WorldDescription(Model):
    """The simulated world: lengths in mm, angles in degrees, brightness in grey levels (0 to 255)."""

    gels: tuple[GelDescription, ...] = Field(default_factory=_paper_gels, min_length=1)
    """Known gels by rising gelatin; between two of them mean and SD are interpolated."""
    needle: NeedleDescription = Field(default_factory=NeedleDescription)
    """The needle."""
    disturbances: DisturbancesDescription = Field(default_factory=DisturbancesDescription)
    """What keeps the needle from its arcs."""
    sheath: SheathDescription = Field(default_factory=SheathDescription)
    """The sheath."""
    layers: tuple[LayerDescription, ...] = ()
    """Layers of a phantom from the origin on; beyond the last of them the gel is as under `gels`."""
    obstacle_shift_sd_mm: NonNegativeMm = 0.0
    """How far, along each axis, a phantom's obstacles lie from where the protocol says: the standard
    deviation [mm]."""
    target_moves_mm: NonNegativeMm = 0.0
    """How far the target moves in the steering plane while the needle covers the distance to it, in a
    direction that is drawn for each phantom [mm]."""
    markers: tuple[PrintedMarkerDescription, ...] = Field((), max_length=20)
    """Printed markers that move with the target, in every phantom."""
    lens: LensDescription = Field(default_factory=LensDescription)
    """The camera's lens and stand."""
    light: LightDescription = Field(default_factory=LightDescription)
    """The light."""
    sheath_tip_at_origin_linear_mm: float = 15.0
    """Position of the linear axis at which the sheath's tip stands at the plane's origin; at 0 it touches the
    gel [mm]."""
    target_mark_mm: tuple[float, float] = (4.0, 100.0)
    """Where the simulated operator sees the target when asked for it, (y, z) [mm]."""
    obstacle_marks_mm: tuple[tuple[float, float, PositiveMm], ...] = Field((), max_length=100)
    """Obstacles cast into every block besides those whose places the protocol states, each as y, z and
    radius; the simulated operator names them in turn when asked for obstacles [mm]."""
    blur_px: Annotated[float, Field(ge=0, le=2)] = 0.8
    """Standard deviation of the lens's blur [px]."""
    noise_sd: Annotated[float, Field(ge=0, le=100)] = 3.0
    """Standard deviation of the noise at the light's level [grey]."""
    bubbles_per_specimen: Annotated[int, Field(ge=0, le=2000)] = 140
    """Air bubbles cast into each specimen [-]."""
    ignores: tuple[str, ...] = ()
    """Camera settings that the simulated camera silently ignores, as some cameras do [-]."""

    def conflicts(self) -> Iterable[Conflict]:
        """Yield gels and layers out of order, and a needle that does not fit the sheath."""
        rising = {
            "gels": ("gelatin_percent", "%", [gel.gelatin_percent for gel in self.gels]),
            "layers": ("until_mm", "mm", [layer.until_mm for layer in self.layers]),
        }
        for listed, (key, unit, values) in rising.items():
            for index, (earlier, later) in enumerate(pairwise(values), start=1):
                if later <= earlier:
                    message = f"{later:g} {unit} follows {earlier:g} {unit}"
                    yield Conflict(f"{listed}.{index}.{key}", message, f"list each once, by rising {key}")
        if self.needle.diameter_mm >= self.sheath.diameter_mm:
            message = f"{self.needle.diameter_mm:g} mm; must be below sheath.diameter_mm"
            yield Conflict("needle.diameter_mm", f"{message}, {self.sheath.diameter_mm:g} mm")


def stream(seed: int, *purpose: str | int | None) -> np.random.Generator:
    """Return the generator for one purpose.

    Parameters
    ----------
    seed : int
        The protocol's seed.
    purpose : str, int or None
        Names and indexes, e.g. ("hole", specimen, hole, needle). Equal arguments give equal streams,
        other arguments unrelated streams.
    """
    text = repr((seed, *purpose))
    return np.random.default_rng(int.from_bytes(hashlib.sha256(text.encode()).digest()[:16], "big"))
