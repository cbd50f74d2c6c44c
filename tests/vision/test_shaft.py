"""The shaft: its ends, its width, and pictures without a shaft."""

from functools import cache

import numpy as np
import pytest

from labrig.errors import MeasurementRefusedError
from labrig.vision.plane import PlaneMap
from labrig.vision.shaft import locate_shaft
from tests.vision.rendering import RenderedBench, RenderedGel, RenderedLens, RenderedNeedle

LENS = RenderedLens()
PLAIN = RenderedGel(bubbles=0, tracks_mm=())


@cache
def bench():
    """Return the lens and its picture of the plane."""
    return RenderedBench(LENS)


@cache
def locate(needle, gel=PLAIN, seed=1, diameter_mm=1.2, sheath_mm=2.0):
    """Return the shaft in a picture of `needle`."""
    return locate_shaft(bench().picture(needle, gel, seed), LENS.plane_map(), diameter_mm, sheath_mm)


@pytest.mark.processors
def test_tip_and_sheath_tip_are_located_within_a_tenth_of_a_millimetre():
    """Both ends of the centre line are found in mm, and the arc between them has the needle's length."""
    needle = RenderedNeedle()
    shaft = locate(needle, RenderedGel())
    ends_mm = LENS.plane_map().to_mm(np.vstack((shaft.entry_px, shaft.tip_px)))
    path = needle.centre_line()[1]
    assert np.hypot(*(ends_mm - path[[0, -1]]).T) == pytest.approx(0.0, abs=0.1)
    assert shaft.length_mm == pytest.approx(40.0, abs=0.1)


@pytest.mark.parametrize("length_mm", [3.0, 12.0])
def test_short_needles_are_found(length_mm):
    """A needle of a few millimetres beyond its sheath has a tip and a length."""
    assert locate(RenderedNeedle(length_mm=length_mm), RenderedGel(), seed=4).length_mm == pytest.approx(
        length_mm, abs=0.15
    )


@pytest.mark.processors
def test_centre_line_lies_on_the_needles_axis_in_spite_of_an_off_centre_glint():
    """No row of the centre line is off by 0.05 mm, and the width is the needle's."""
    needle = RenderedNeedle()
    shaft = locate(needle)
    path = needle.centre_line(0.02)[1]
    inner = shaft.arc_mm < 37.0
    distances = np.linalg.norm(shaft.centre_mm[inner, None] - path[None, ::5], axis=2).min(axis=1)
    assert distances.max() < 0.06
    assert shaft.width_mm == pytest.approx(1.2, abs=0.02)


@pytest.mark.processors
@pytest.mark.parametrize("stated_mm", [0.85, 1.75])
def test_stated_diameter_may_be_off_by_half(stated_mm):
    """The measured shaft does not depend on the diameter that the caller states."""
    shaft = locate(RenderedNeedle(), RenderedGel(), diameter_mm=stated_mm)
    assert shaft.width_mm == pytest.approx(1.2, abs=0.02)
    assert shaft.length_mm == pytest.approx(40.0, abs=0.1)


@pytest.mark.parametrize(
    ("insertion", "turned"),
    [
        ("left", lambda image: image[::-1, ::-1]),
        ("down", lambda image: np.rot90(image, -1)),
        ("up", lambda image: np.rot90(image, 1)),
    ],
)
def test_turning_the_picture_turns_the_measurement_with_it(insertion, turned):
    """A picture turned with its insertion gives the same points in mm, to rounding."""
    image = bench().picture(RenderedNeedle(), RenderedGel(), 2)
    px_per_mm, origin = 15.5, np.array([320.0, 200.0])
    h, w = image.shape
    places = {
        "left": (w - 1 - origin[0], h - 1 - origin[1]),
        "down": (h - 1 - origin[1], origin[0]),
        "up": (origin[1], w - 1 - origin[0]),
    }
    straight = locate_shaft(image, PlaneMap.from_scale(px_per_mm, (320.0, 200.0), "right"), 1.2, 2.0)
    plane = PlaneMap.from_scale(px_per_mm, places[insertion], insertion)
    shaft = locate_shaft(np.ascontiguousarray(turned(image)), plane, 1.2, 2.0)
    assert shaft.centre_mm[50:500] == pytest.approx(straight.centre_mm[50:500], abs=0.05)
    assert shaft.length_mm == pytest.approx(straight.length_mm, abs=0.02)


@pytest.mark.parametrize(
    ("needle", "gel", "words"),
    [
        (RenderedNeedle(length_mm=-5.0), RenderedGel(), "no needle is seen beyond the sheath"),
        (
            RenderedNeedle(length_mm=-5.0),
            RenderedGel(tracks_mm=(0.0, 10.0)),
            "no needle is seen beyond the sheath",
        ),
        (RenderedNeedle(sheath_diameter_mm=1.2), RenderedGel(), "no sheath is seen"),
        (None, RenderedGel(), "nothing dark and straight enters"),
        (RenderedNeedle(sheath_tip_mm=(-20.0, 0.0)), RenderedGel(), "runs out of the picture"),
        (RenderedNeedle(), RenderedGel(extra=(RenderedNeedle(sheath_tip_mm=(-15.0, 0.0)),)), "two shafts"),
        (RenderedNeedle(diameter_mm=0.5, sheath_diameter_mm=1.9), PLAIN, "may look between"),
    ],
    ids=["sheath", "sheath-before-its-own-track", "no-sheath", "gel", "out-of-frame", "two-needles", "thin"],
)
def test_what_is_no_needle_with_its_tip_is_refused_with_the_reason(needle, gel, words):
    """The refusal says what the picture shows instead."""
    with pytest.raises(MeasurementRefusedError, match=words):
        locate(needle, gel, seed=3)


@pytest.mark.parametrize(
    ("picture", "px_per_mm", "words"),
    [
        (np.zeros((720, 1280), np.uint8), 15.0, "the picture is black"),
        (np.full((720, 1280), 128, np.uint8), 15.0, "the picture is even grey"),
        (np.full((720, 1280, 3), 255, np.uint8), 15.0, "the picture is white"),
        (np.eye(5, 400, dtype=np.uint8) * np.uint8(200), 15.0, "too few to show a needle"),
        (np.eye(100, dtype=np.uint8) * np.uint8(200), 1.0, r"1\.2 pixels wide"),
    ],
)
def test_even_and_tiny_pictures_are_refused(picture, px_per_mm, words):
    """Black, grey and saturated pictures, and those with too few pixels for a needle, are refused by name."""
    with pytest.raises(MeasurementRefusedError, match=words):
        locate_shaft(picture, PlaneMap.from_scale(px_per_mm, (0.0, 0.0), "right"), 1.2, None)


@pytest.mark.parametrize(("heading_rad", "seed"), [(0.0647, 1016), (-0.09, 2), (0.12, 3)])
def test_slanting_sheath_is_one_shaft(heading_rad, seed):
    """A sheath that crosses several rows at the border is not taken for two shafts."""
    needle = RenderedNeedle(15.1, 24.0, sheath_tip_mm=(4.95, 2.67), heading_rad=heading_rad)
    assert locate(needle, RenderedGel(), seed).length_mm == pytest.approx(24.0, abs=0.15)
