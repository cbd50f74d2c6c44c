"""The tip by a template: where it is found, and what is refused."""

import math
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from labrig.errors import FileFormatError, InputError, PictureError
from labrig.protocol.model import Direction
from labrig.vision.template import TipTemplate, load_template, save_template
from labrig.vision.tip import locate_tip
from tests.vision.rendering import RenderedGel
from tests.vision.tips import bench, tip

TEMPLATE = tip(0.0, 100).template()


def _off_px(found: tuple[float, float] | None, px: tuple[float, float]) -> float:
    assert found is not None
    return math.dist(found, px)


@pytest.mark.processors
def test_a_tip_is_found_to_a_tenth_of_a_pixel_with_its_heading_known_within_five_degrees() -> None:
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


def test_the_whole_picture_is_searched_where_nothing_is_predicted() -> None:
    """The tip is found without a predicted place, heading or roll."""
    shown = tip(0.5, 3)
    assert _off_px(locate_tip(shown.picture, TEMPLATE).tip_px, shown.px) < 0.3


@pytest.mark.processors
def test_a_bevel_turned_over_is_found_by_the_mirrored_template() -> None:
    """A template taken at roll 0 serves at roll pi, even if there is no glint there."""
    shown = tip(0.3, 4, over=True)
    fix = locate_tip(shown.picture, TEMPLATE, near_px=shown.px, heading_rad=0.3, roll_rad=math.pi)
    assert _off_px(fix.tip_px, shown.px) < 1.0


@pytest.mark.parametrize("insertion", ["down", "left", "up"])
def test_a_template_serves_whichever_way_the_insertion_points(insertion: Direction) -> None:
    """The heading is relative to another direction of insertion; the picture stays the same."""
    shown = tip(0.4, 5)
    turned = TEMPLATE.relative_to(insertion)
    angle = {"down": -0.5, "left": 1.0, "up": 0.5}[insertion] * math.pi
    predicted = math.remainder(0.4 - angle, 2 * math.pi)
    fix = locate_tip(shown.picture, turned, near_px=shown.px, heading_rad=predicted, roll_rad=0.0)
    assert _off_px(fix.tip_px, shown.px) < 0.2


def test_pixels_in_colour_say_the_same_as_in_grey() -> None:
    """A blue-green-red picture is converted to grey."""
    shown = tip(0.2, 6)
    grey, colour = (
        locate_tip(picture, TEMPLATE, near_px=shown.px, heading_rad=0.2)
        for picture in (shown.picture, np.repeat(shown.picture[..., None], 3, axis=-1))
    )
    assert _off_px(colour.tip_px, grey.tip_px or (0, 0)) < 0.05


@pytest.mark.parametrize("level", [0, 128, 255, None])
def test_a_picture_without_a_needle_shows_no_tip(level: int | None) -> None:
    """A dark, grey or saturated picture, and gel with bubbles and tracks, are refused, whatever correlates there."""
    gel = bench().picture(None, RenderedGel(), 1) if level is None else np.full((480, 640), level, np.uint8)
    for near in (None, (300.0, 200.0)):
        fix = locate_tip(gel, TEMPLATE, near_px=near, heading_rad=0.0)
        assert (fix.accepted, fix.tip_px) == (False, None)
        assert fix.reason is not None


def test_a_masked_tip_is_not_found() -> None:
    """Masked pixels belong to no tip, and no place beside them is accepted either."""
    shown = tip(0.2, 7)
    mask = np.zeros(shown.picture.shape, bool)
    u, v = (round(at) for at in shown.px)
    mask[v - 6 : v + 7, u - 6 : u + 7] = True
    assert not locate_tip(shown.picture, TEMPLATE, near_px=shown.px, heading_rad=0.2, mask=mask).accepted


@pytest.mark.processors
def test_two_tips_cannot_be_told_apart() -> None:
    """If two places score alike, neither is accepted."""
    shown = tip(0.0, 8)
    twice = shown.picture.copy()
    u, v = (round(at) for at in shown.px)
    twice[v + 80 : v + 141, u - 30 : u + 31] = shown.picture[v - 30 : v + 31, u - 30 : u + 31]
    fix = locate_tip(twice, TEMPLATE, heading_rad=0.0, roll_rad=0.0)
    assert not fix.accepted
    assert "told apart" in (fix.reason or "")


def test_a_tip_predicted_outside_of_the_picture_is_refused() -> None:
    """The region is cut to the picture; if nothing is left, there is no tip."""
    shown = tip(0.0, 9)
    assert not locate_tip(shown.picture, TEMPLATE, near_px=(5000.0, 200.0), heading_rad=0.0).accepted


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
def test_what_cannot_be_searched_is_an_error(
    picture: np.ndarray, predicted: dict[str, Any], error: type[Exception]
) -> None:
    """A picture smaller than the template, or not of 8 bits, and a prediction that is not finite."""
    with pytest.raises(error):
        locate_tip(picture, TEMPLATE, **predicted)


def test_a_template_comes_back_from_its_files_as_it_was(tmp_path: Path) -> None:
    """Picture, tip, heading, insertion and roll survive, by the name of either file."""
    kept = TipTemplate(TEMPLATE.picture, (20.25, 19.5), -0.3, "down", 1.5)
    save_template(tmp_path / "tip.png", kept, {"command": "test"})
    for name in ("tip.png", "tip.json"):
        found = load_template(tmp_path / name)
        assert np.array_equal(found.picture, kept.picture)
        stated = (found.tip_px, found.heading_rad, found.insertion, found.roll_rad)
        assert stated == ((20.25, 19.5), -0.3, "down", 1.5)


def test_a_template_may_be_written_by_hand(tmp_path: Path) -> None:
    """A cropped picture and a JSON file with tip and heading in degrees are enough."""
    cv2.imwrite(str(tmp_path / "tip.png"), TEMPLATE.picture)
    (tmp_path / "tip.json").write_text('{"tip_px": [20, 19.5], "heading_deg": 90}')
    assert load_template(tmp_path / "tip.png").heading_rad == pytest.approx(math.pi / 2)


@pytest.mark.parametrize(
    "document",
    [
        "{",
        '{"tip_px": [20, 20]}',
        '{"tip_px": [20, 20], "heading_rad": 0, "heading_deg": 0}',
        '{"tip_px": [20, 900], "heading_rad": 0}',
        '{"tip_px": [20, 20], "heading_rad": NaN}',
        '{"tip_px": [20, 20], "heading_rad": 0, "insertion": "sideways"}',
    ],
)
def test_a_template_whose_json_says_something_else_is_refused(tmp_path: Path, document: str) -> None:
    """Missing, malformed, incomplete and contradictory files are refused by name."""
    cv2.imwrite(str(tmp_path / "tip.png"), TEMPLATE.picture)
    with pytest.raises(FileFormatError, match=r"tip\.json"):
        load_template(tmp_path / "tip.png")
    (tmp_path / "tip.json").write_text(document)
    with pytest.raises(FileFormatError, match=r"tip\.json"):
        load_template(tmp_path / "tip.png")


@pytest.mark.parametrize("picture", [np.full((41, 41), 90, np.uint8), np.zeros((4, 4), np.uint8)])
def test_a_flat_or_tiny_template_is_refused(tmp_path: Path, picture: np.ndarray) -> None:
    """A flat template is refused: nothing correlates with it."""
    cv2.imwrite(str(tmp_path / "tip.png"), picture)
    (tmp_path / "tip.json").write_text('{"tip_px": [1, 1], "heading_rad": 0}')
    with pytest.raises(PictureError, match=r"tip\.png"):
        load_template(tmp_path / "tip.png")
