"""The tip by a template: where it is found, and what is refused."""

import math
from typing import Any

import cv2
import numpy as np
import pytest

from labrig.errors import FileFormatError, InputError, PictureError
from labrig.vision.template import TipTemplate, cut_template, load_template, save_template
from labrig.vision.tip import locate_tip
from tests.vision.renderer import Gel
from tests.vision.tips import CAMERA, tip

TEMPLATE = tip(0.0, 100).template()


def _off_px(found: tuple[float, float] | None, px: tuple[float, float]) -> float:
    return math.dist(found, px)


@pytest.mark.processors
def test_a_tip_is_found_to_a_tenth_of_a_pixel_with_its_heading_known_within_five_degrees():
    """At noise 3 the error is at most 0.1 px rms along each axis, wherever the needle heads."""
    random = np.random.default_rng(0)
    errors = []
    for seed in range(16):
        shown = tip(float(random.uniform(-0.9, 0.9)), seed)
        near = (shown.px[0] + random.uniform(-15, 15), shown.px[1] + random.uniform(-15, 15))
        predicted = shown.heading_rad + random.uniform(-1, 1) * math.radians(5.0)
        fix = locate_tip(shown.picture, TEMPLATE, near_px=near, heading_rad=predicted, roll_rad=0.0)
        assert fix.accepted, fix.reason
        assert fix.heading_rad == pytest.approx(shown.heading_rad, abs=math.radians(1.0))
        errors.append(np.subtract(fix.tip_px, shown.px))
    assert np.sqrt(np.mean(np.square(errors), axis=0)) == pytest.approx(0.0, abs=0.1)


@pytest.mark.processors
def test_a_bevel_turned_over_is_found_by_the_mirrored_template():
    """A template taken at roll 0 serves at roll pi, even if there is no glint there, in colour as in grey."""
    shown = tip(0.3, 4, over=True)
    for picture in (shown.picture, np.repeat(shown.picture[..., None], 3, axis=-1)):
        fix = locate_tip(picture, TEMPLATE, near_px=shown.px, heading_rad=0.3, roll_rad=math.pi)
        assert _off_px(fix.tip_px, shown.px) < 1.0


@pytest.mark.parametrize(
    ("insertion", "turn"), [("down", -0.5), ("left", 1.0), ("up", 0.5), (None, 0.0)], ids=str
)
def test_a_template_serves_whichever_way_the_insertion_points(insertion, turn):
    """The heading is relative to another direction of insertion; where nothing is predicted all is searched."""
    shown = tip(0.4, 5)
    hint: dict[str, Any] = {}
    if insertion:
        hint = {
            "near_px": shown.px,
            "heading_rad": math.remainder(0.4 - turn * math.pi, 2 * math.pi),
            "roll_rad": 0.0,
        }
    fix = locate_tip(shown.picture, TEMPLATE.relative_to(insertion or "right"), **hint)
    assert _off_px(fix.tip_px, shown.px) < (0.2 if insertion else 0.3)


@pytest.mark.parametrize("level", [0, 128, 255, None])
def test_a_picture_without_a_needle_shows_no_tip(level):
    """A dark, grey or saturated picture, and gel with bubbles and tracks, are refused, whatever correlates there."""
    gel = Gel(None, CAMERA).take(1) if level is None else np.full((480, 640), level, np.uint8)
    for near in (None, (300.0, 200.0)):
        fix = locate_tip(gel, TEMPLATE, near_px=near, heading_rad=0.0)
        assert (fix.accepted, fix.tip_px) == (False, None)
        assert fix.reason is not None


def test_a_tip_that_is_masked_or_predicted_outside_of_the_picture_is_not_found():
    """Masked pixels belong to no tip, nor does a place beside them; of a region outside nothing is left."""
    shown = tip(0.2, 7)
    mask = np.zeros(shown.picture.shape, bool)
    u, v = (round(at) for at in shown.px)
    mask[v - 6 : v + 7, u - 6 : u + 7] = True
    assert not locate_tip(shown.picture, TEMPLATE, near_px=shown.px, heading_rad=0.2, mask=mask).accepted
    assert not locate_tip(shown.picture, TEMPLATE, near_px=(5000.0, 200.0), heading_rad=0.2).accepted


@pytest.mark.processors
def test_two_tips_cannot_be_told_apart():
    """If two places score alike, neither is accepted."""
    shown = tip(0.0, 8)
    twice = shown.picture.copy()
    u, v = (round(at) for at in shown.px)
    twice[v + 80 : v + 141, u - 30 : u + 31] = shown.picture[v - 30 : v + 31, u - 30 : u + 31]
    fix = locate_tip(twice, TEMPLATE, heading_rad=0.0, roll_rad=0.0)
    assert not fix.accepted
    assert "told apart" in (fix.reason or "")


@pytest.mark.parametrize(
    ("picture", "predicted", "error"),
    [
        (np.zeros((30, 30), np.uint8), {}, PictureError),
        (np.zeros((480, 640), np.uint16), {}, PictureError),
        (np.zeros((0, 0), np.uint8), {}, PictureError),
        (tip().picture, {"near_px": (math.nan, 0.0)}, InputError),
        (tip().picture, {"heading_rad": math.inf}, InputError),
        (tip().picture, {"region_px": 0.0, "near_px": (1.0, 1.0)}, InputError),
    ],
)
def test_what_cannot_be_searched_is_an_error(picture, predicted, error):
    """A picture smaller than the template, or not of 8 bits, and a prediction that is not finite."""
    with pytest.raises(error):
        locate_tip(picture, TEMPLATE, **predicted)


@pytest.mark.parametrize("place", [(19, 20), (20, 19), (620, 459), (619, 460)])
def test_a_square_that_leaves_the_picture_is_no_template(place):
    """A pixel further inside it is one."""
    picture = np.random.default_rng(1).integers(0, 256, (480, 640)).astype(np.uint8)
    with pytest.raises(PictureError, match="does not lie in the picture"):
        cut_template(picture, place, 0.0, side_px=41, insertion="right")
    inside = tuple(np.clip(place, 20, (619, 459)).tolist())
    assert cut_template(picture, inside, 0.0, side_px=41, insertion="right").tip_px == (20, 20)


def test_a_template_comes_back_from_its_files_as_it_was(tmp_path):
    """Picture, tip, heading, insertion and roll survive, by the name of either file; it may be written by hand."""
    kept = TipTemplate(TEMPLATE.picture, (20.25, 19.5), -0.3, "down", 1.5)
    save_template(tmp_path / "tip.png", kept, {"command": "test"})
    for name in ("tip.png", "tip.json"):
        found = load_template(tmp_path / name)
        assert np.array_equal(found.picture, kept.picture)
        stated = (found.tip_px, found.heading_rad, found.insertion, found.roll_rad)
        assert stated == ((20.25, 19.5), -0.3, "down", 1.5)
    (tmp_path / "tip.json").write_text('{"tip_px": [2, 1.5], "heading_deg": 90}')
    assert load_template(tmp_path / "tip.png").heading_rad == pytest.approx(math.pi / 2)
    for flat_or_tiny in (np.full((41, 41), 90, np.uint8), np.zeros((4, 4), np.uint8)):
        cv2.imwrite(str(tmp_path / "tip.png"), flat_or_tiny)
        with pytest.raises(PictureError, match=r"tip\.png"):
            load_template(tmp_path / "tip.png")


@pytest.mark.parametrize(
    "document",
    [
        None,
        "{",
        '{"tip_px": [20, 20]}',
        '{"tip_px": [20, 20], "heading_rad": 0, "heading_deg": 0}',
        '{"tip_px": [20, 900], "heading_rad": 0}',
        '{"tip_px": [20, 20], "heading_rad": NaN}',
        '{"tip_px": [20, 20], "heading_rad": 0, "insertion": "sideways"}',
    ],
)
def test_a_template_that_cannot_be_one_is_refused(tmp_path, document):
    """Missing, malformed, incomplete and contradictory files are refused by name."""
    cv2.imwrite(str(tmp_path / "tip.png"), TEMPLATE.picture)
    if document is not None:
        (tmp_path / "tip.json").write_text(document)
    with pytest.raises(FileFormatError, match=r"tip\.json"):
        load_template(tmp_path / "tip.png")
