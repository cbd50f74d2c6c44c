"""The sheath's tip and heading, found in pictures that this room's own renderer draws."""

import cv2
import numpy as np
import pytest

from labrig.errors import MeasurementRefusedError, PictureError
from labrig.vision.curvature import CurvatureSettings, measure_curvature
from labrig.vision.plane import PlaneMap
from labrig.vision.sheath import measure_sheath
from tests.vision.renderer import Gel, Needle

PLANE = Gel().camera.plane_map()


def sheath(tip_mm: tuple[float, float] = (0.0, 0.0), heading_rad: float = 0.0) -> Gel:
    """Return a needle that is still inside its sheath, whose tip is at (y, z)."""
    return Gel(Needle(length_mm=-1.0, entry_mm=(tip_mm[1], -tip_mm[0]), heading_rad=-heading_rad))


def test_tip_and_heading_are_found_among_glints_bubbles_and_tracks() -> None:
    """Ten sheaths: each within 0.05 mm along, 0.03 mm across and a quarter of a degree, and no bias of half of that."""
    random = np.random.default_rng(3)
    off = []
    for seed in range(10):
        *tip, heading = random.normal(0.0, (0.5, 1.0, 0.02)).tolist()
        found = measure_sheath(sheath(tip, heading).take(seed), PLANE, 2.0)
        off.append((found.tip_mm[1] - tip[1], found.tip_mm[0] - tip[0], found.heading_rad - heading))
    along, across, turn = np.abs(off).T
    assert along.max() < 0.05
    assert across.max() < 0.03
    assert np.degrees(turn.max()) < 0.25
    assert np.all(np.abs(np.mean(off, axis=0)) < (0.025, 0.015, np.radians(0.12)))


@pytest.mark.processors
@pytest.mark.parametrize("aside_mm", [0.55, -0.85])
def test_a_bubble_at_the_end_moves_nothing(aside_mm: float) -> None:
    """A dark bubble of 0.8 mm in front of two thirds of the end, or of half of it on the other side: below 0.1 mm."""
    image = sheath().take(1, bubbles=0)
    u, v = PLANE.to_px(np.array([[aside_mm, 0.5]]))[0]
    cv2.circle(image, (round(u), round(v)), round(0.8 / PLANE.mm_per_px), 60, -1, cv2.LINE_AA)
    assert measure_sheath(image, PLANE, 2.0).tip_mm == pytest.approx((0.0, 0.0), abs=0.1)


def test_a_glint_along_the_middle_refuses_nothing() -> None:
    """A stripe of 0.5 mm as bright as the gel along the whole middle: the tip is found as without it."""
    image = sheath().take(1, bubbles=0)
    from_uv, to_uv = np.rint(PLANE.to_px(np.array([[0.0, -40.0], [0.0, -0.05]]))).astype(int)
    cv2.line(image, from_uv.tolist(), to_uv.tolist(), 150, round(0.5 / PLANE.mm_per_px), cv2.LINE_AA)
    assert measure_sheath(image, PLANE, 2.0).tip_mm == pytest.approx((0.0, 0.0), abs=0.05)


def test_heading_is_measured_after_the_needle_is_out() -> None:
    """The sheath behind the step of width still shows its heading; without a sheath there is no heading."""
    measured = measure_curvature(Gel(Needle(heading_rad=-0.03)).take(2), PLANE, CurvatureSettings())
    assert measured.sheath_heading_rad == pytest.approx(0.03, abs=0.005)
    bare = Gel(Needle(sheath_mm=1.2)).take(2)
    measured = measure_curvature(bare, PLANE, CurvatureSettings(sheath_diameter_mm=None))
    assert measured.sheath_heading_rad is None


@pytest.mark.parametrize(
    ("gel", "plane", "words"),
    [
        (Gel(None), PLANE, "nothing dark and straight enters"),
        (sheath((0.0, -18.5)), PLANE, "is not a shaft"),
        (sheath((0.0, -17.9)), PLANE, "mm of the sheath are seen, and 3 mm are the least"),
        (sheath(), PlaneMap.from_scale(15.0, (320.0, 200.0), "right", (640, 480)), "640 x 480"),
    ],
    ids=["no shaft", "too short for a shaft", "too short for a heading", "another camera"],
)
def test_what_shows_no_sheath_is_refused(gel: Gel, plane: PlaneMap, words: str) -> None:
    """A picture without a shaft, one in which too little of it is seen for a heading, and one of another camera.

    A millimetre more of it is enough.
    """
    with pytest.raises((MeasurementRefusedError, PictureError), match=words):
        measure_sheath(gel.take(1, bubbles=0, tracks_mm=()), plane, 2.0)
    found = measure_sheath(sheath((0.0, -17.0)).take(1, bubbles=0, tracks_mm=()), PLANE, 2.0)
    assert found.tip_mm == pytest.approx((0.0, -17.0), abs=0.05)
