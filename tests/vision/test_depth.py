"""How far the end of a needle is out of the plane, by its width and length in pictures of an own renderer."""

import numpy as np
import pytest

from labrig.vision.depth import Depth, measure_depth
from labrig.vision.out_of_plane import Perspective
from labrig.vision.plane import PlaneMap
from labrig.vision.shaft_tip import measure_shaft_tip
from tests.vision.deep_needle import (
    CAMERA_MM,
    FOOT_MM,
    NEEDLE_MM,
    ORIGIN_PX,
    PX_PER_MM,
    SHEATH_MM,
    SIZE_PX,
    DeepNeedle,
)

PLANE = PlaneMap.from_scale(PX_PER_MM, ORIGIN_PX, "right", SIZE_PX)
PERSPECTIVE = Perspective(np.array(FOOT_MM), CAMERA_MM)


def measure(needle: DeepNeedle, before_mm: float, inserted_mm: float | None = None) -> Depth | None:
    """Measure the depth of a drawn needle that wanders, with the standard deviation of its end beforehand."""
    end = measure_shaft_tip(needle.draw(), PLANE, NEEDLE_MM, SHEATH_MM)
    at_mm = np.linspace(0.0, needle.length_mm, 40)
    first, second = np.minimum.outer(at_mm, at_mm), np.maximum.outer(at_mm, at_mm)
    covariance = before_mm**2 * first**2 * (3 * second - first) / (2 * needle.length_mm**3)
    return measure_depth(end, PERSPECTIVE, inserted_mm or needle.length_mm, at_mm, covariance)


@pytest.mark.parametrize("x_mm", [-6.0, 0.0, 6.0])
def test_depth_is_read_from_width_and_length(x_mm: float) -> None:
    """Where little is known before, the picture tells the end's depth within three of its standard deviations."""
    depth = measure(DeepNeedle(x_mm=x_mm), 5.0)
    assert depth is not None
    assert depth.sd_mm < 1.5
    assert depth.x_mm == pytest.approx(x_mm, abs=3 * depth.sd_mm)
    assert not depth.contradicts


@pytest.mark.processors
def test_a_needle_that_left_the_plane_contradicts_what_was_known() -> None:
    """A needle that looks 8 mm behind the plane where 0.5 mm were expected contradicts; the picture counts then."""
    left, kept = measure(DeepNeedle(x_mm=8.0), 0.5), measure(DeepNeedle(), 0.5)
    assert left is not None
    assert kept is not None
    assert (left.contradicts, kept.contradicts) == (True, False)
    assert left.x_mm == left.picture_x_mm == pytest.approx(8.0, abs=3 * left.sd_mm)
    assert kept.sd_mm < 0.5


@pytest.mark.processors
def test_slip_is_not_taken_for_depth() -> None:
    """A needle whose tip lags behind by 1 % of its length is still where it is."""
    depth = measure(DeepNeedle(length_mm=100.0), 2.0, inserted_mm=101.0)
    assert depth is not None
    assert not depth.contradicts
    assert abs(depth.x_mm) < 2 * depth.sd_mm


def test_rough_edges_tell_no_depth() -> None:
    """Widths that scatter by 5 %, as in photographs before ruled paper, tell nothing."""
    assert measure(DeepNeedle(rough=0.05), 5.0) is None


def test_a_short_needle_tells_no_depth() -> None:
    """A needle of 15 mm has too few widths."""
    assert measure(DeepNeedle(length_mm=15.0), 5.0) is None
