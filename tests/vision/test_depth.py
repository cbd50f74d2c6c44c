"""How far the end of a needle is out of the plane, by its width and length in pictures of an own renderer."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from labrig.vision.depth import measure_depth
from labrig.vision.out_of_plane import Perspective
from labrig.vision.plane import PlaneMap
from labrig.vision.shaft_tip import measure_shaft_tip
from tests.vision.renderer import FloatArray, Gel, Needle, Photo, flat_camera

PX_PER_MM, ORIGIN_PX, SIZE_PX = 10.0, (150.0, 160.0), (1300, 220)
FOOT_MM, CAMERA_MM = (0.0, 50.0), 185.0
PLANE = PlaneMap.from_scale(PX_PER_MM, ORIGIN_PX, "right", SIZE_PX)
PERSPECTIVE = Perspective(np.array(FOOT_MM), CAMERA_MM)
STEP_MM = 0.05


@dataclass(frozen=True)
class DeepNeedle(Needle):
    """A needle in two bends, whose end is x_mm behind the plane; `rough` is the relative scatter of its width.

    A point at (x, y, z) is seen at the foot of the camera plus D / (D + x) of its distance from there, and so reduced.
    """

    x_mm: float = 0.0
    rough: float = 0.0
    seed: int = 1

    def path_mm(self) -> FloatArray:
        """Return points (N, 2) of the seen centre line."""
        share = np.arange(0.0, self.length_mm, STEP_MM) / self.length_mm
        heading = 0.25 * np.sin(2 * np.pi * share)
        along = STEP_MM * np.sqrt(1 - np.gradient(self._depth_mm(share), STEP_MM) ** 2)
        places = np.column_stack((np.cumsum(along * np.cos(heading)), -np.cumsum(along * np.sin(heading))))
        foot = np.array((FOOT_MM[1], -FOOT_MM[0]))
        return np.asarray(foot + self._scale(share)[:, None] * (places - foot))

    def half_mm(self, along: FloatArray) -> FloatArray:
        """Return half the seen width."""
        blocks = np.random.default_rng(self.seed).standard_normal(int(self.length_mm / 3) + 2)
        rough = 1 + self.rough * blocks[np.clip(along / 3, 0, self.length_mm / 3).astype(int)]
        return 0.5 * self.diameter_mm * self._scale(np.clip(along / self.length_mm, 0.0, 1.0)) * rough

    def _depth_mm(self, share: FloatArray) -> FloatArray:
        return self.x_mm * share**2 * (3 - share) / 2

    def _scale(self, share: FloatArray) -> FloatArray:
        return np.asarray(CAMERA_MM / (CAMERA_MM + self._depth_mm(share)))


def deep(length_mm=100.0, **how):
    """Return a needle of one grey level."""
    grey: Any = {"level": 60.0, "sheath_level": 60.0, "line": 0.0, "bevel": 0.0}
    return DeepNeedle(length_mm=length_mm, **grey, **how)


def measure(needle, before_mm, inserted_mm=None, way_mm=None):
    """Measure the depth of a drawn needle that wanders, with the standard deviation of its end beforehand."""
    photo, camera = Photo(noise=2.0), replace(flat_camera(PX_PER_MM, SIZE_PX), origin_px=ORIGIN_PX)
    picture = Gel(needle, camera, photo, 175.0, tracks_mm=(), bubbles=0).draw()
    end = measure_shaft_tip(picture, PLANE, 1.2, 2.0)
    at_mm = np.linspace(0.0, needle.length_mm, 14)
    first, second = np.minimum.outer(at_mm, at_mm), np.maximum.outer(at_mm, at_mm)
    covariance = before_mm**2 * first**2 * (3 * second - first) / (2 * needle.length_mm**3)
    inserted_mm = inserted_mm or needle.length_mm
    return measure_depth(end, PERSPECTIVE, inserted_mm, at_mm, covariance, way_mm=way_mm)


@pytest.mark.parametrize("x_mm", [-6.0, 0.0, 6.0])
def test_depth_is_read_from_width_and_length(x_mm):
    """Where little is known before, the picture tells the end's depth within three of its standard deviations."""
    depth = measure(deep(x_mm=x_mm), 5.0)
    assert depth.sd_mm < 1.5
    assert depth.x_mm == pytest.approx(x_mm, abs=3 * depth.sd_mm)
    assert not depth.contradicts


@pytest.mark.processors
def test_a_needle_that_left_the_plane_contradicts_what_was_known():
    """A needle that looks 8 mm behind the plane where 0.5 mm were expected contradicts; the picture counts then.

    One whose tip lags behind by 1 % of its length is still where it is.
    """
    left, kept = measure(deep(x_mm=8.0), 0.5), measure(deep(), 0.5)
    assert (left.contradicts, kept.contradicts) == (True, False)
    assert left.x_mm == left.picture_x_mm == pytest.approx(8.0, abs=3 * left.sd_mm)
    assert kept.sd_mm < kept.picture_sd_mm
    slipped = measure(deep(), 2.0, inserted_mm=101.0)
    assert not slipped.contradicts
    assert abs(slipped.x_mm) < 2 * slipped.sd_mm


@pytest.mark.parametrize(("slip", "zero_mm"), [(0.0, 0.0), (0.01, 0.0), (0.01, 0.4)])
@pytest.mark.parametrize("x_mm", [-3.0, 0.0, 3.0])
def test_where_the_tip_was_seen_on_the_way_tells_depth_from_slip(x_mm, slip, zero_mm):
    """The end is known twice as well then, within three standard deviations; a tip seen beside the shaft is none."""
    needle = deep(x_mm=x_mm)
    seen = needle.path_mm()[:: round(2.0 / STEP_MM)]
    way_mm = np.column_stack((zero_mm + 2.0 * np.arange(len(seen)) / (1.0 - slip), -seen[:, 1], seen[:, 0]))
    way_mm[20] += (0.0, 3.0, -5.0)
    inserted_mm = zero_mm + needle.length_mm / (1.0 - slip)
    alone, depth = measure(needle, 5.0, inserted_mm), measure(needle, 5.0, inserted_mm, way_mm=way_mm)
    assert depth.sd_mm < 0.5 * alone.sd_mm
    assert depth.x_mm == pytest.approx(x_mm, abs=3 * depth.sd_mm)


def test_rough_edges_and_short_needles_tell_no_depth():
    """Widths that scatter by 5 %, as in photographs before ruled paper, tell nothing; 15 mm have too few of them."""
    assert measure(deep(rough=0.05), 5.0) is None
    assert measure(deep(15.0), 5.0) is None
