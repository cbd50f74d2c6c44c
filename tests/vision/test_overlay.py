"""The drawing of a measurement."""

import numpy as np

from labrig.vision import CurvatureSettings, PlaneMap, draw_measurement, measure_curvature
from tests.vision.rendering import Bench, Gel, Lens, Needle


def test_drawing_changes_only_a_copy_near_what_was_measured():
    """Centre line, circle, entry, the sheath's arrow and the tip are drawn; pixels far from the needle stay."""
    lens = Lens()
    image = Bench(lens).picture(Needle(), Gel(), 1)
    before = image.copy()
    measurement = measure_curvature(image, lens.plane_map(), CurvatureSettings())
    drawn = draw_measurement(image, measurement, lens.plane_map())
    assert drawn.shape == (720, 1280, 3)
    assert np.array_equal(image, before)
    changed = np.argwhere((drawn != image[..., None]).any(axis=2))
    assert len(changed) > 500
    line = measurement.centre_line_px[::5, ::-1]
    distances = np.linalg.norm(changed[:, None] - line[None], axis=2).min(axis=1)
    assert distances.max() < 100.0
    purple = np.abs(drawn.astype(int) - (167, 121, 204)).max(axis=2) < 30
    assert purple.sum() > 30


def test_refused_picture_is_returned_as_it_is_in_colour():
    """Nothing was measured, nothing is drawn."""
    image = np.full((100, 120), 90, np.uint8)
    plane = PlaneMap.from_scale(15.0, (0.0, 0.0), "right")
    drawn = draw_measurement(image, measure_curvature(image, plane, CurvatureSettings()), plane)
    assert np.array_equal(drawn, np.repeat(image[..., None], 3, axis=2))
