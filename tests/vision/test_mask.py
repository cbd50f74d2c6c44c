"""Masks: pixels that a person marks as not the needle."""

import cv2
import numpy as np
import pytest

from labrig.errors import PictureError
from labrig.vision.curvature import CurvatureSettings, measure_curvature
from labrig.vision.picture import load_mask
from labrig.vision.plane import PlaneMap

from .rendering import RenderedBench, RenderedGel, RenderedLens, RenderedNeedle

LENS = RenderedLens()
SETTINGS = CurvatureSettings()


@pytest.fixture(scope="module")
def two_needles():
    """Return a picture with a second needle above the first, and the polygon around it."""
    other = RenderedNeedle(sheath_tip_mm=(8.0, 0.0), bend=1)
    picture = RenderedBench(LENS).picture(RenderedNeedle(), RenderedGel(extra=(other,), tracks_mm=()), 3)
    return picture, [[0, 0], [1279, 0], [1279, 60], [420, 130], [0, 130]]


def test_a_mask_takes_a_second_needle_away(two_needles, tmp_path):
    """Two needles are refused. With the second masked, the first is measured, in pictures of the mask's size alone."""
    picture, polygon = two_needles
    drawn = cv2.fillPoly(np.zeros(picture.shape, np.uint8), [np.array(polygon, np.int32)], 255)
    cv2.imwrite(str(tmp_path / "mask.png"), drawn)
    mask = load_mask(tmp_path / "mask.png")
    assert "Two shafts" in measure_curvature(picture, LENS.plane_map(), SETTINGS).reason
    found = measure_curvature(picture, LENS.plane_map(), SETTINGS, mask=mask)
    assert found.accepted
    assert found.radius_mm == pytest.approx(28.0, abs=0.1)
    with pytest.raises(PictureError, match="the mask is for 1280 x 720"):
        measure_curvature(picture[:100], PlaneMap.from_scale(15.0, (0.0, 0.0), "right"), SETTINGS, mask=mask)


def test_masked_stretch_of_the_needle_does_not_count():
    """Edges under a mask are not used, and the radius stays the same."""
    picture = RenderedBench(LENS).picture(RenderedNeedle(), RenderedGel(tracks_mm=()), 4)
    masked = np.zeros(picture.shape, bool)
    masked[:, 560:580] = True
    whole = measure_curvature(picture, LENS.plane_map(), SETTINGS)
    part = measure_curvature(picture, LENS.plane_map(), SETTINGS, mask=masked)
    assert len(part.line.px) <= len(whole.line.px) - 15
    assert not ((part.line.px[:, 0] > 562) & (part.line.px[:, 0] < 577)).any()
    assert part.radius_mm == pytest.approx(whole.radius_mm, abs=0.05)
