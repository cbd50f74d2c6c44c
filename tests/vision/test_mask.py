"""Masks: pixels that a person marks as not the needle, by a picture or by polygons."""

import json

import cv2
import numpy as np
import pytest

from labrig.errors import FileFormatError, InputError, PictureError
from labrig.vision.curvature import CurvatureSettings, measure_curvature
from labrig.vision.mask import load_mask

from .rendering import RenderedBench, RenderedGel, RenderedLens, RenderedNeedle

LENS = RenderedLens()
SETTINGS = CurvatureSettings()


@pytest.fixture(scope="module")
def two_needles():
    """Return a picture with a second needle above the first, and the polygon around it."""
    other = RenderedNeedle(sheath_tip_mm=(8.0, 0.0), bend=1)
    picture = RenderedBench(LENS).picture(RenderedNeedle(), RenderedGel(extra=(other,), tracks_mm=()), 3)
    return picture, [[0, 0], [1279, 0], [1279, 60], [420, 130], [0, 130]]


def write_json(path, document):
    """Return the path of a JSON file with this content."""
    path.write_text(json.dumps(document))
    return path


def test_polygons_take_a_second_needle_away(two_needles, tmp_path):
    """Two needles are refused. With the second masked, the first is measured."""
    picture, polygon = two_needles
    mask = load_mask(write_json(tmp_path / "mask.json", [polygon]))
    assert "Two shafts" in measure_curvature(picture, LENS.plane_map(), SETTINGS).reason
    found = measure_curvature(picture, LENS.plane_map(), SETTINGS, masked=mask.find_masked(picture))
    assert found.accepted
    assert found.radius_mm == pytest.approx(28.0, abs=0.1)


def test_picture_is_white_where_there_is_no_needle(two_needles, tmp_path):
    """A mask picture has the same effect as the polygon, in every picture of its size and in no other."""
    picture, polygon = two_needles
    drawn = cv2.fillPoly(np.zeros(picture.shape, np.uint8), [np.array(polygon, np.int32)], 255)
    cv2.imwrite(str(tmp_path / "mask.png"), drawn)
    mask = load_mask(tmp_path / "mask.png")
    found = measure_curvature(picture, LENS.plane_map(), SETTINGS, masked=mask.find_masked(picture))
    assert found.accepted
    with pytest.raises(PictureError, match=r"the mask mask\.png is for 1280 x 720"):
        mask.find_masked(picture[:100])


def test_masked_stretch_of_the_needle_does_not_count():
    """Edges under a mask are not used, and the radius stays the same."""
    picture = RenderedBench(LENS).picture(RenderedNeedle(), RenderedGel(tracks_mm=()), 4)
    masked = np.zeros(picture.shape, bool)
    masked[:, 560:580] = True
    whole = measure_curvature(picture, LENS.plane_map(), SETTINGS)
    part = measure_curvature(picture, LENS.plane_map(), SETTINGS, masked=masked)
    assert len(part.centre_line_px) <= len(whole.centre_line_px) - 15
    assert not ((part.centre_line_px[:, 0] > 562) & (part.centre_line_px[:, 0] < 577)).any()
    assert part.radius_mm == pytest.approx(whole.radius_mm, abs=0.05)


@pytest.mark.parametrize(
    ("document", "message"),
    [
        ([[[0, 0], [1, 1]]], "2 corners"),
        ([1, 2], "no polygons"),
        ([[[0, 0], [1, 1], ["x", 2]]], "no poly"),
        ({"*": [[[0, 0], [1, 1], [2, 2]]]}, "no polygons"),
        ([[[0, 0], [1e9, 0], [0, 1e9]]], "a corner more than 1048576 px"),
    ],
)
def test_refuses_what_are_no_polygons(tmp_path, document, message):
    """Malformed files are refused with an example of the right form."""
    with pytest.raises(FileFormatError, match=message) as caught:
        load_mask(write_json(tmp_path / "mask.json", document))
    assert "[[[0, 0]" in caught.value.hint


def test_refuses_masks_that_are_not_there(tmp_path):
    """A missing file is wrong input, of either kind."""
    for name in ("mask.json", "mask.png"):
        with pytest.raises(InputError, match=name):
            load_mask(tmp_path / name)


def test_refuses_a_mask_that_is_too_deep(tmp_path):
    """A file of brackets alone is told like any other that holds no polygons."""
    path = tmp_path / "mask.json"
    path.write_text("[" * 200_000)
    with pytest.raises(FileFormatError, match="nested deeper than 64 levels"):
        load_mask(path)
