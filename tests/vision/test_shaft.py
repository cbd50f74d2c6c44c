"""The shaft: its ends and width, among walls, wide sheaths, gel edges and other shafts; pictures without a shaft."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from labrig.errors import MeasurementRefusedError
from labrig.vision.picture import read_picture
from labrig.vision.plane import PlaneMap
from labrig.vision.shaft import locate_shaft
from tests.vision.renderer import Bar, Gel, Needle, Photo, flat_camera

NEEDLE = Needle(ramp_mm=3.0)
CLEAN = Gel(NEEDLE, bubbles=0, tracks_mm=())
CAMERA = CLEAN.camera
# A needle without a lens before it, and beside it what scenes add.
BENT = Needle(40.0, 40.0, (15.0, 24.0), level=54.0, sheath_level=66.0, line=100.0, line_at=-0.2, fade=0.35)
SCENE = Gel(
    BENT,
    flat_camera(11.0, (960, 540)),
    Photo(0.12, fall=0.05, blur_px=0.9),
    bubbles=12,
    tracks_mm=(8.0, -9.0),
)
EVEN = replace(SCENE, photo=replace(SCENE.photo, slope=0.0, fall=0.0))


def locate(gel, seed=1, diameter_mm=None):
    """Return the shaft in a picture, whose needle's diameters are stated."""
    needle = gel.needle or NEEDLE
    sheath_mm = needle.sheath_mm if needle.sheath_mm > needle.diameter_mm or gel.camera is CAMERA else None
    return locate_shaft(gel.take(seed), gel.camera.plane_map(), diameter_mm or needle.diameter_mm, sheath_mm)


@pytest.mark.processors
@pytest.mark.parametrize("stated_mm", [1.2, 0.85, 1.75])
def test_tip_and_sheath_tip_are_located_within_a_tenth_of_a_millimetre(stated_mm):
    """Both ends of the centre line are found in mm, and the arc between them; a stated diameter may be off by half."""
    shaft = locate(Gel(NEEDLE), diameter_mm=stated_mm)
    ends_mm = CAMERA.to_mm((shaft.entry_px, shaft.tip_px))
    assert np.hypot(*(ends_mm - np.array((NEEDLE.entry_mm, NEEDLE.tip_mm))).T) == pytest.approx(0.0, abs=0.1)
    assert shaft.width_mm == pytest.approx(1.2, abs=0.02)
    assert shaft.length_mm == pytest.approx(40.0, abs=0.1)


@pytest.mark.processors
def test_centre_line_lies_on_the_needles_axis_in_spite_of_an_off_centre_glint():
    """No row of the centre line is off by 0.06 mm, and the width is the needle's."""
    shaft = locate(CLEAN)
    path = NEEDLE.path_mm()[::5]
    down_right = shaft.centre_mm[shaft.arc_mm < 37.0]
    places = np.column_stack((down_right[:, 1], -down_right[:, 0]))
    assert np.linalg.norm(places[:, None] - path[None], axis=2).min(axis=1).max() < 0.06
    assert shaft.width_mm == pytest.approx(1.2, abs=0.02)


@pytest.mark.parametrize(
    ("needle", "seed"),
    [
        (Needle(length_mm=3.0), 4),
        (Needle(length_mm=12.0), 4),
        (Needle(15.1, 24.0, (2.67, -4.95), -0.0647), 1016),
        (Needle(15.1, 24.0, (2.67, -4.95), 0.09), 2),
        (Needle(15.1, 24.0, (2.67, -4.95), -0.12), 3),
    ],
    ids=["3 mm", "12 mm", "slanting", "the other way", "steep"],
)
def test_short_needles_and_slanting_sheaths_are_one_shaft(needle, seed):
    """A few millimetres beyond the sheath have a length; a sheath that crosses several rows at the border is one."""
    assert locate(Gel(needle), seed).length_mm == pytest.approx(needle.length_mm, abs=0.15)


def test_a_shining_sheath_is_found_by_a_trace_along_its_edge():
    """The picture is of a simulated rig: the trace of the sheath follows one of its two dark lines."""
    picture = read_picture(Path(__file__).parent / "marks" / "shining_sheath.png")
    plane = flat_camera(9.49, (300, 170)).plane_map()
    assert locate_shaft(picture, plane, 1.2, 2.0).length_mm == pytest.approx(5.1, abs=0.15)


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
    image = Gel(NEEDLE).take(2)
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
    ("gel", "words"),
    [
        (Gel(Needle(length_mm=-5.0)), "no needle is seen beyond the sheath"),
        (Gel(Needle(length_mm=-5.0), tracks_mm=(0.0, 10.0)), "no needle is seen beyond the sheath"),
        (Gel(Needle(sheath_mm=1.2)), "no sheath is seen"),
        (Gel(None), "nothing dark and straight enters"),
        (Gel(Needle(entry_mm=(0.0, 20.0))), "runs out of the picture"),
        (Gel(below=(Needle(entry_mm=(0.0, 15.0)),)), "two shafts"),
        (replace(CLEAN, needle=Needle(diameter_mm=0.5, sheath_mm=1.9)), "may look between"),
    ],
    ids=["sheath", "sheath-before-its-own-track", "no-sheath", "gel", "out-of-frame", "two-needles", "thin"],
)
def test_what_is_no_needle_with_its_tip_is_refused_with_the_reason(gel, words):
    """The refusal says what the picture shows instead."""
    with pytest.raises(MeasurementRefusedError, match=words):
        locate_shaft(gel.take(3), CAMERA.plane_map(), 1.2, 2.0)


DIAGONAL = np.eye(720, 1280, dtype=np.uint8)


@pytest.mark.parametrize(
    ("picture", "px_per_mm", "words"),
    [
        (np.zeros((720, 1280), np.uint8), 15.0, "the picture is black"),
        (128 + 7 * DIAGONAL, 15.0, "the picture is even grey"),
        (128 + 8 * DIAGONAL, 15.0, "nothing dark and straight"),
        (np.full((720, 1280, 3), 255, np.uint8), 15.0, "the picture is white"),
        (np.eye(5, 400, dtype=np.uint8) * np.uint8(200), 15.0, "too few to show a needle"),
        (np.eye(100, dtype=np.uint8) * np.uint8(200), 1.0, r"1\.2 pixels wide"),
    ],
)
def test_even_and_tiny_pictures_are_refused(picture, px_per_mm, words):
    """Black, grey and saturated pictures, and those with too few pixels for a needle, are refused by name."""
    with pytest.raises(MeasurementRefusedError, match=words):
        locate_shaft(picture, PlaneMap.from_scale(px_per_mm, (0.0, 0.0), "right"), 1.2, None)


BRIGHT, GREY = 240.0, 165.0
AT_EDGE = replace(BENT, entry_mm=(30.0, 24.0), length_mm=30.0)
EDGE_RAD = np.pi / 2 - 0.04
TABLE = Bar((0.0, 24.0), EDGE_RAD, 48.0, 225.0)
HOLDER = Bar((12.0, 24.0), 0.0, 18.0, 50.0, length_mm=24.0)
WALLED = Needle(31.0, 18.3, (12.8, 25.6), 0.02, -1, sheath_mm=1.8, level=60.0, line=35.0, line_at=-0.2)


@pytest.mark.parametrize(
    ("gel", "seed"),
    [
        # Sheaths of up to four needle diameters.
        *((replace(SCENE, needle=replace(BENT, sheath_mm=1.2 * r, radius_mm=abs(k), bend=int(np.sign(k)))), 3)
          for r, k in ((1.2, 50), (1.67, -30), (2.5, 50), (3.2, -30), (4.0, 50))),
        # Bright walls over a stretch, and what is as grey as gel: the rest is plain to the eye.
        *((replace(SCENE, above=(Bar((at, 24.0), 1.5, width, BRIGHT, opacity),)), 4)
          for at, width, opacity in ((33.0, 2.5, 1.0), (33.0, 4.0, 0.8), (33.0, 6.0, 1.0))),
        *((replace(EVEN, above=(Bar((at, 24.0), 1.5, width, GREY),)), 4) for at, width in ((30.0, 4.0), (40.0, 8.0))),
        # It ends before a bright wall along it, although gel looks dark between the wall and its edge.
        (Gel(WALLED, flat_camera(12.9, (1119, 630)), SCENE.photo, below=(Bar((40.0, 17.9), -0.025, 3.4, 240.0, 0.85),),
             tracks_mm=()), 4),
        # A gel's edge, with a bright table, a dark one, or a holder before it.
        (replace(SCENE, needle=AT_EDGE, below=(TABLE,)), 5),
        (replace(SCENE, needle=AT_EDGE, above=(replace(TABLE, level=46.0),)), 5),
        (replace(SCENE, needle=AT_EDGE, below=(TABLE,), above=(HOLDER,)), 5),
        # A dark bar from border to border is a wall and no second shaft, and a wire across diverts nothing.
        *((replace(SCENE, below=(Bar((40.0, 12.0), 0.02, width, 60.0),)), 7) for width in (1.0, 2.0, 3.5)),
        *((replace(SCENE, below=(Bar((33.0, 27.0), angle, 1.0, 60.0),)), 8) for angle in (-0.9, -1.2, 1.57)),
    ],
)  # fmt: skip
def test_both_ends_are_found_whatever_stands_beside(gel, seed):
    """Wide sheaths, walls over, beside and along the needle, edges of the gel, and wires: within 0.5 and 0.33 mm."""
    shaft = locate(gel, seed)
    tip, entry = gel.camera.to_mm((shaft.tip_px, shaft.entry_px))
    assert np.hypot(*(tip - gel.needle.tip_mm)) < 0.5
    assert np.hypot(*(entry - gel.needle.entry_mm)) < 0.33


RUNNING_IN = Needle(1e6, 46.6, (10.56, 26.2), -0.17, level=53.0, line=126.0, line_at=-0.2)
UPPER = Needle(36.1, 36.3, (13.5, 25.9), 0.013, -1, sheath_mm=2.08, level=70.0, line=64.0, line_at=-0.2)
PATCH, HAZE = Bar((34.0, 24.0), 1.5, 8.0, GREY), Bar((60.0, 24.0), 1.5, 44.0, GREY)
CROSSING = replace(BENT, entry_mm=(12.0, 37.0), heading_rad=-0.45, radius_mm=1e6, length_mm=45.0)


@pytest.mark.parametrize(
    ("gel", "words"),
    [
        *((replace(EVEN, needle=replace(BENT, line=0.0), above=(PATCH, replace(HAZE, opacity=opacity))),
           r"the shaft is lost at .* but goes on") for opacity in (0.6, 0.75, 0.85)),
        (replace(EVEN, needle=replace(BENT, sheath_mm=1.2), above=(Bar((8.0, 24.0), 1.57, 32.0, GREY),)),
         "the shaft begins|nothing dark"),
        (replace(SCENE, above=(Bar((15.0, 24.0), 1.57, 6.0, BRIGHT),)), "the sheath's tip is hidden"),
        (replace(SCENE, needle=replace(BENT, length_mm=45.0), above=(Bar((60.0, 24.0), 1.5, 50.0, BRIGHT),)),
         "may hide the tip"),
        (replace(SCENE, below=(CROSSING,)), "two shafts"),
        (Gel(UPPER, flat_camera(11.4, (991, 558)), SCENE.photo, below=(RUNNING_IN,)), "something lies over it"),
    ],
    ids=["pale 0.6", "pale 0.75", "pale 0.85", "begins in plain gel", "hidden sheath's tip", "tip at a wall",
         "crossing needles", "one on top of another"],
)  # fmt: skip
def test_a_needle_of_which_an_end_is_not_seen_is_refused(gel, words):
    """What is hidden or too pale is not guessed, and of two needles it cannot be seen which is meant."""
    with pytest.raises(MeasurementRefusedError, match=words):
        locate(gel, 5)
