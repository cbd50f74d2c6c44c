"""The sheath's tip and heading, found in pictures that this room's own renderer draws."""

import cv2
import numpy as np
import pytest

from labrig.errors import MeasurementRefusedError, PictureError
from labrig.vision.curvature import CurvatureSettings, measure_curvature
from labrig.vision.plane import PlaneMap
from labrig.vision.sheath import measure_sheath
from tests.vision.rendering import RenderedBench, RenderedGel, RenderedLens, RenderedNeedle

LENS = RenderedLens()
BENCH = RenderedBench(LENS)
PLANE = LENS.plane_map()
INSIDE = -1.0


def sheath(tip_mm: tuple[float, float] = (0.0, 0.0), heading_rad: float = 0.0) -> RenderedNeedle:
    """Return a needle that is still inside its sheath."""
    return RenderedNeedle(length_mm=INSIDE, sheath_tip_mm=tip_mm, heading_rad=heading_rad)


def test_tip_and_heading_are_found_among_glints_bubbles_and_tracks() -> None:
    """Ten sheaths: each within 0.05 mm along, 0.03 mm across and a quarter of a degree, and no bias of half of that."""
    random = np.random.default_rng(3)
    off = []
    for seed in range(10):
        tip, heading = (
            (float(random.normal(0.0, 0.5)), float(random.normal(0.0, 1.0))),
            float(random.normal(0.0, 0.02)),
        )
        found = measure_sheath(BENCH.picture(sheath(tip, heading), RenderedGel(), seed), PLANE, 2.0)
        off.append((found.tip_mm[1] - tip[1], found.tip_mm[0] - tip[0], found.heading_rad - heading))
    along, across, turn = np.abs(off).T
    assert along.max() < 0.05
    assert across.max() < 0.03
    assert np.degrees(turn.max()) < 0.25
    assert np.all(np.abs(np.mean(off, axis=0)) < (0.025, 0.015, np.radians(0.12)))


@pytest.mark.processors
def test_a_bubble_at_the_end_moves_nothing() -> None:
    """A dark bubble of 0.8 mm in front of two thirds of the end moves the tip by less than 0.1 mm."""
    image = BENCH.picture(sheath(), RenderedGel(bubbles=0), 1)
    u, v = PLANE.to_px(np.array([[0.55, 0.5]]))[0]
    cv2.circle(image, (round(u), round(v)), round(0.8 / PLANE.mm_per_px), 60, -1, cv2.LINE_AA)
    assert measure_sheath(image, PLANE, 2.0).tip_mm == pytest.approx((0.0, 0.0), abs=0.1)


def test_heading_is_measured_after_the_needle_is_out() -> None:
    """The sheath behind the step of width still shows its heading; without a sheath there is no heading."""
    image = BENCH.picture(RenderedNeedle(heading_rad=0.03), RenderedGel(), 2)
    measured = measure_curvature(image, PLANE, CurvatureSettings())
    assert measured.sheath_heading_rad == pytest.approx(0.03, abs=0.005)
    bare = BENCH.picture(RenderedNeedle(sheath_diameter_mm=1.2), RenderedGel(), 2)
    assert (
        measure_curvature(bare, PLANE, CurvatureSettings(sheath_diameter_mm=None)).sheath_heading_rad is None
    )


def test_a_picture_without_a_sheath_is_refused() -> None:
    """A picture without a shaft, or of another camera, is refused."""
    with pytest.raises(MeasurementRefusedError):
        measure_sheath(BENCH.picture(None, RenderedGel(bubbles=0, tracks_mm=()), 1), PLANE, 2.0)
    other = PlaneMap.from_scale(15.0, (320.0, 200.0), "right", (640, 480))
    with pytest.raises(PictureError):
        measure_sheath(BENCH.picture(sheath(), RenderedGel(), 1), other, 2.0)


def test_a_sheath_that_hardly_enters_the_picture_is_refused() -> None:
    """A visible length of 2 mm does not determine the heading."""
    image = BENCH.picture(sheath((0.0, -18.5)), RenderedGel(bubbles=0), 1)
    with pytest.raises(MeasurementRefusedError):
        measure_sheath(image, PLANE, 2.0)
