"""The effect of grid pictures before and after a run on its radii."""

import numpy as np
import pytest

from labrig.analysis.sentinel import compare_grid_pictures
from labrig.experiments.shared.curvature_result import PictureResult
from labrig.experiments.shared.picture_results import complete_picture
from labrig.record.events import FrameLine
from labrig.vision.error_budget import ErrorBudget
from labrig.vision.plane import PlaneMap
from tests.analysis.test_origin import picture
from tests.vision.renderer import Photo, Picture, Sheet, flat_camera

PX_PER_MM = 16.0
PLANE = PlaneMap.from_scale(PX_PER_MM, (0.0, 0.0), "right", (800, 600))
LINES = [
    FrameLine(frame=0, file="", role="grid-before"),
    FrameLine(frame=1, file="", role="final"),
    FrameLine(frame=2, file="", role="grid-after"),
]


def grid(pitch_px: float) -> Picture:
    """Draw ruled paper."""
    photo = Photo(noise=2.0)
    return Sheet("1", flat_camera(pitch_px, (800, 600)), photo, ink="grey", width_mm=0.15, samples=2).draw()


BARE = np.full((600, 800), 120, np.uint8)


def radius(**known: object) -> PictureResult:
    """Return an accepted picture with a radius."""
    values = {"radius_mm": 28.0, "sigma_radius_mm": 0.05, "radius_ci95_mm": (27.9, 28.1), **known}
    return picture(0).model_copy(update=values)


def test_drift_becomes_an_error_bar():
    """A drift of 0.2 % widens sigma and interval, and leaves the radius unchanged."""
    pictures = grid(PX_PER_MM), None, grid(PX_PER_MM * 1.002)
    sentinel = compare_grid_pictures(pictures.__getitem__, LINES, PLANE, 1.0)
    assert sentinel.drift == pytest.approx(0.002, abs=2e-4)
    wider = complete_picture(radius(), None, sentinel)
    assert wider.accepted
    assert wider.radius_mm == 28.0
    assert wider.sigma_radius_mm == pytest.approx(np.hypot(0.05, 0.056), rel=0.1)
    assert wider.radius_budget_mm is None
    listed = complete_picture(radius(radius_budget_mm=ErrorBudget(fit=0.05)), None, sentinel)
    assert listed.radius_budget_mm is not None
    assert listed.radius_budget_mm.total == pytest.approx(listed.sigma_radius_mm)
    assert wider.radius_ci95_mm == pytest.approx((28.0 - 0.149, 28.0 + 0.149), abs=0.015)


HALVED = PlaneMap.from_scale(PX_PER_MM / 2.0, (0.0, 0.0), "right", (800, 600))


@pytest.mark.parametrize(
    ("plane", "before", "after", "words"),
    [
        (PLANE, grid(PX_PER_MM), grid(PX_PER_MM * 1.02), "the camera was bumped"),
        (HALVED, grid(PX_PER_MM), grid(PX_PER_MM), "lines are 16.0 px apart in the picture"),
        (PLANE, BARE, BARE, "cannot be compared"),
    ],
    ids=["bumped", "wrong map", "no paper"],
)
def test_what_the_paper_contradicts_refuses_every_radius(plane, before, after, words):
    """Another scale after the run, another one than the map's, or no grid: the reason is at each picture."""
    sentinel = compare_grid_pictures(lambda frame: after if frame else before, LINES, plane, 1.0)
    assert not sentinel.accepted
    assert sentinel.view == plane.view_sentence()
    assert HALVED.view_sentence() == "The picture is 100 mm wide and 75 mm high at the paper."
    refused = complete_picture(radius(), None, sentinel)
    assert not refused.accepted
    assert words in (refused.reason or "")


def test_run_without_both_pictures_is_told_so():
    """An aborted run without the second picture is not refused; the result states that the drift is unknown."""
    sentinel = compare_grid_pictures(lambda _: grid(PX_PER_MM), LINES[:1], PLANE, 1.0)
    assert sentinel.drift is None
    assert "both before and after" in (sentinel.reason or "")
    assert complete_picture(radius(), None, sentinel) == complete_picture(radius(), None, None) == radius()
