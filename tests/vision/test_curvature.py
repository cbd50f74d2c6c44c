"""The radius: its error, the coverage of its interval, and its refusals."""

import json
import re
from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from labrig.errors import PictureError
from labrig.vision.curvature import (
    CurvatureMeasurement,
    CurvatureSettings,
    measure_curvature,
    refuse_cut_short,
)
from labrig.vision.picture import load_mask
from labrig.vision.plane import PlaneMap
from tests.vision.renderer import Gel, Needle, Photo

NEEDLE = Needle(ramp_mm=3.0)
GEL = Gel(NEEDLE)
PLANE = GEL.camera.plane_map()
SETTINGS = CurvatureSettings()


def measure(needle=NEEDLE, seed=1, settings=SETTINGS, mask=None, **gel):
    """Return the measurement of a picture of a needle."""
    return measure_curvature(GEL.take(seed, needle=needle, **gel), PLANE, settings, mask=mask)


def test_radius_is_right_and_its_interval_holds_it_as_often_as_it_says():
    """Over radii, headings, bevels and tracks no radius is off by 0.05 mm, the mean not by 0.005 mm, none is refused.

    At least 83 % of the 95 % intervals contain the true radius (two sigma of the count); they are not too wide.
    """
    random = np.random.default_rng(18)
    errors, held, widths = [], [], []
    for seed in range(16):
        radius_mm, heading_rad = random.normal(28.0, 1.0), random.normal(0.0, 0.01)
        bevel = 1.0 / np.tan(np.deg2rad(random.uniform(20.0, 60.0)))
        needle = replace(NEEDLE, radius_mm=radius_mm, heading_rad=heading_rad, bevel=bevel)
        tracks = tuple(10.0 * k for k in range(-int(random.integers(0, 3)), int(random.integers(1, 3))) if k)
        m = measure(needle, seed, tracks_mm=tracks)
        assert m.accepted
        errors.append(m.radius_mm - radius_mm)
        held.append(m.radius_ci95_mm[0] <= radius_mm <= m.radius_ci95_mm[1])
        widths.append(np.diff(m.radius_ci95_mm)[0])
    assert np.abs(errors).max() < 0.05
    assert abs(np.mean(errors)) < 0.005
    assert np.mean(held) > 0.83
    assert np.median(widths) < 0.05


@pytest.mark.processors
def test_measurement_names_the_needles_ends_and_bend():
    """Entry, tip, arc length, centre and bend are those of the needle drawn; the window lies between its ends."""
    m = measure()
    right, down = NEEDLE.tip_mm
    assert m.sheath_tip_mm == pytest.approx((0.0, 0.0), abs=0.05)
    assert m.entry_mm == m.sheath_tip_mm
    assert m.tip_mm == pytest.approx((-down, right), abs=0.1)
    assert m.arc_length_mm == pytest.approx(40.0, abs=0.1)
    assert m.bend == "-y"
    assert m.centre_mm == pytest.approx((-28.0, 1.5), abs=0.05)
    assert m.residual_rms_mm < 0.005
    fitted = m.line.mm[slice(*m.line.window)]
    assert np.hypot(*np.diff(fitted, axis=0).T).sum() == pytest.approx(40.0 - 4.0 - 2.0, abs=0.3)


def test_hinges_closing_inside_the_window_cost_the_radius_its_certainty():
    """The interval shows twelve millimetres of closing hinges in the window; outside the window they are harmless."""
    inside, outside = (
        measure(Needle(ramp_mm=12.0), settings=SETTINGS.model_copy(update={"window_start_mm": start}))
        for start in (0.0, 13.0)
    )
    assert not inside.accepted
    assert outside.accepted
    assert outside.radius_mm == pytest.approx(28.0, abs=0.1)
    assert inside.sigma_radius_mm > 10.0 * outside.sigma_radius_mm


@pytest.mark.parametrize(
    ("needle", "changed", "words"),
    [
        (replace(NEEDLE, length_mm=5.0), {}, ("Of 5.0 mm of needle", "15 mm is the least")),
        (replace(NEEDLE, length_mm=20.1), {}, ("Of 20.", "15 mm is the least")),
        (replace(NEEDLE, radius_mm=900.0), {}, ("standard deviation", "0.5 mm is the most")),
        (Needle(12.0, ramp_mm=80.0), {"max_radius_sigma_mm": 50.0}, ("circle",)),
    ],
    ids=["short", "less than the window", "gentle", "on two arcs"],
)
def test_a_needle_without_a_sure_radius_is_found_and_refused(needle, changed, words):
    """Too short, almost straight, or on no single circle: the sentence names value and limit."""
    m = measure(needle, 6, SETTINGS.model_copy(update=changed))
    assert (m.found, m.accepted) == (True, False)
    assert all(word in m.reason for word in words), m.reason


def test_needle_without_a_sheath_enters_at_the_border():
    """Without a stated sheath the arc length counts from the border, and the sheath's tip is unknown."""
    bare = SETTINGS.model_copy(update={"sheath_diameter_mm": None, "window_start_mm": 24.0})
    m = measure(replace(NEEDLE, sheath_mm=1.2), settings=bare)
    assert m.accepted
    assert m.sheath_tip_mm is None
    assert m.arc_length_mm == pytest.approx(40.0 - GEL.camera.to_mm([(0.0, 200.0)])[0, 0], abs=0.7)
    assert m.radius_mm == pytest.approx(28.0, abs=0.05)


@pytest.mark.processors
@pytest.mark.parametrize(
    "gel",
    [
        {"photo": replace(GEL.photo, noise=12.0)},
        {"photo": replace(GEL.photo, blur_px=3.0)},
        {"bubbles": 300},
        {"needle": replace(NEEDLE, level=130.0, sheath_level=130.0, line=20.0)},
        {"photo": Photo(0.3, fall=0.3)},
    ],
    ids=["noise", "blur", "bubbles", "faint", "uneven-light"],
)
def test_harder_pictures_still_give_the_radius(gel):
    """Noise, blur, bubbles, a faint needle and uneven light cost less than a tenth of a millimetre."""
    m = measure(**{"needle": NEEDLE, "seed": 7, **gel})
    assert m.accepted
    assert m.radius_mm == pytest.approx(28.0, abs=0.1)


def test_a_picture_that_loses_the_needle_of_its_neighbours_is_refused():
    """A shaft that both neighbours show go on is lost; another needle, and the first picture, may be short."""
    long = measure()
    short = measure(replace(NEEDLE, length_mm=20.0), 6)
    other = measure(replace(NEEDLE, length_mm=20.0, entry_mm=(0.0, -2.0)), 6)
    unread = CurvatureMeasurement.refuse("It cannot be read.")
    film = refuse_cut_short([short, long, short, long, other, long, unread])
    assert [one.found for one in film] == [True, True, False, True, True, True, False]
    assert re.match(
        r"The needle is lost after (19\.9|20\.0) mm: the pictures before and after", film[2].reason
    )


def test_refused_picture_is_all_none_but_the_reason():
    """A picture without a needle says why in a sentence; its document has the keys of any other, and no NaN."""
    documents = [measure(needle).model_dump() for needle in (None, NEEDLE)]
    known = {name: value for name, value in documents[0].items() if value is not None}
    assert known == {"found": False, "accepted": False, "reason": known["reason"]}
    assert known["reason"][0].isupper()
    assert known["reason"].endswith(".")
    for document in documents:
        assert json.loads(json.dumps(document, allow_nan=False)).keys() == documents[0].keys()


@settings(max_examples=40, deadline=None)
@given(
    blocks=arrays(np.uint8, st.tuples(st.integers(1, 12), st.integers(1, 16))),
    enlarge=st.integers(1, 24),
    insertion=st.sampled_from(["right", "left", "up", "down"]),
    sheath_mm=st.sampled_from([None, 2.0]),
)
def test_no_picture_raises(blocks, enlarge, insertion, sheath_mm):
    """Any picture yields a measurement with a reason or a radius."""
    image = cv2.resize(blocks, None, fx=enlarge, fy=enlarge, interpolation=cv2.INTER_CUBIC)
    plane = PlaneMap.from_scale(8.0, (0.0, 0.0), insertion)
    m = measure_curvature(image, plane, SETTINGS.model_copy(update={"sheath_diameter_mm": sheath_mm}))
    assert m.accepted == (m.reason is None)


def test_a_mask_takes_a_second_needle_away(tmp_path):
    """Two needles are refused. With the second masked, the first is measured, in pictures of the mask's size alone."""
    two = {"below": (Needle(entry_mm=(0.0, -8.0), bend=-1),), "tracks_mm": (), "seed": 3}
    polygon = np.array([[0, 0], [1279, 0], [1279, 60], [420, 130], [0, 130]], np.int32)
    cv2.imwrite(str(tmp_path / "mask.png"), cv2.fillPoly(np.zeros((720, 1280), np.uint8), [polygon], 255))
    mask = load_mask(tmp_path / "mask.png")
    assert "Two shafts" in measure(**two).reason
    found = measure(mask=mask, **two)
    assert found.accepted
    assert found.radius_mm == pytest.approx(28.0, abs=0.1)
    with pytest.raises(PictureError, match="the mask is for 1280 x 720"):
        measure_curvature(GEL.take(1)[:100], PlaneMap.from_scale(15.0, (0, 0), "right"), SETTINGS, mask=mask)


def test_masked_stretch_of_the_needle_does_not_count():
    """Edges under a mask are not used, and the radius stays the same."""
    masked = np.zeros((720, 1280), bool)
    masked[:, 560:580] = True
    whole, part = (measure(seed=4, mask=mask, tracks_mm=()) for mask in (None, masked))
    assert len(part.line.px) <= len(whole.line.px) - 15
    assert not ((part.line.px[:, 0] > 562) & (part.line.px[:, 0] < 577)).any()
    assert part.radius_mm == pytest.approx(whole.radius_mm, abs=0.05)
