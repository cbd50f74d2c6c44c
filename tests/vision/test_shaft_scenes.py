"""The shaft among walls, wide sheaths, gel edges and other shafts, in scenes whose ends are known."""

import numpy as np
import pytest

from labrig.errors import MeasurementRefusedError
from labrig.vision.plane import PlaneMap
from labrig.vision.shaft import Shaft, locate_shaft
from tests.vision.gel_scenes import Scene, SceneBar, SceneNeedle


def locate(scene: Scene) -> Shaft:
    """Return the shaft in a scene, whose needle's diameters are stated."""
    assert scene.needle is not None
    diameter_mm, ratio = scene.needle.diameter_mm, scene.needle.sheath_ratio
    plane = PlaneMap.from_scale(scene.px_per_mm, (0.0, 0.0), "right")
    return locate_shaft(scene.draw(), plane, diameter_mm, None if ratio is None else ratio * diameter_mm)


def require_ends(scene: Scene) -> None:
    """Require the needle's tip within half a millimetre and the sheath's tip within a third."""
    assert scene.needle is not None
    shaft = locate(scene)
    tip, entry = scene.px(np.array([scene.needle.tip_mm, scene.needle.sheath_tip_mm]))
    assert np.hypot(*(shaft.tip_px - tip)) < 0.5 * scene.px_per_mm
    if scene.needle.sheath_ratio is not None:
        assert np.hypot(*(shaft.entry_px - entry)) < 0.33 * scene.px_per_mm


@pytest.mark.parametrize(
    ("ratio", "curvature_per_mm"), [(1.2, 0.02), (1.67, -1 / 30), (2.5, 0.02), (3.2, -1 / 30), (4.0, 0.02)]
)
def test_sheath_may_be_up_to_four_times_as_wide_as_the_needle(ratio, curvature_per_mm):
    """Both ends are found for sheaths of 1.2 to 4 needle diameters."""
    require_ends(Scene(SceneNeedle(sheath_ratio=ratio, curvature_per_mm=curvature_per_mm), seed=3))


@pytest.mark.parametrize(("wall_mm", "opacity"), [(2.5, 1.0), (4.0, 0.8), (6.0, 1.0)])
def test_needle_goes_on_behind_a_bright_wall(wall_mm, opacity):
    """A bright wall across the needle hides a stretch of it and not its tip."""
    wall = SceneBar((33.0, 24.0), 1.5, wall_mm, 240.0, opacity)
    require_ends(Scene(SceneNeedle(), above=(wall,), seed=4))


@pytest.mark.parametrize(("width_mm", "at_mm"), [(4.0, 30.0), (8.0, 40.0)])
def test_needle_goes_on_behind_what_is_as_grey_as_gel(width_mm, at_mm):
    """A stretch that is not seen does not end the needle where the rest is plain to the eye."""
    patch = SceneBar((at_mm, 24.0), 1.5, width_mm, 165.0)
    require_ends(Scene(SceneNeedle(), above=(patch,), unevenness=0.0, seed=4))


def test_gel_beside_a_bright_wall_is_no_needle():
    """A needle that ends before a wall along it ends there, although gel looks dark between the wall and its edge."""
    needle = SceneNeedle((12.8, 25.6), 0.02, -0.0323, 18.3, sheath_ratio=1.5, glint=0.2)
    wall = SceneBar((40.0, 17.9), -0.025, 3.4, 240.0, 0.85)
    require_ends(Scene(needle, px_per_mm=12.9, width_px=1119, height_px=630, below=(wall,), seed=4))


def test_two_shafts_on_top_of_each_other_are_no_sheath():
    """Where two needles run into one another, the wide place is refused, and no sheath's tip is seen there."""
    needle = SceneNeedle((13.5, 25.9), 0.013, -0.0277, 36.3, sheath_ratio=1.73, level=70.0, glint=0.4)
    other = SceneNeedle((10.56, 27.07), -0.223, 0.0, 46.6, level=53.0, glint=0.74)
    with pytest.raises(MeasurementRefusedError, match="something lies over it"):
        locate(Scene(needle, px_per_mm=11.4, width_px=991, height_px=558, others=(other,), seed=4))


@pytest.mark.parametrize("opacity", [0.6, 0.75, 0.85])
def test_an_end_beyond_which_the_needle_goes_on_is_refused(opacity):
    """Behind a stretch that is not seen the needle is too pale to be measured, and plain to the eye: it has no tip."""
    patch, haze = SceneBar((34.0, 24.0), 1.5, 8.0, 165.0), SceneBar((60.0, 24.0), 1.5, 44.0, 165.0, opacity)
    with pytest.raises(MeasurementRefusedError, match=r"the shaft is lost at .* but goes on"):
        locate(Scene(SceneNeedle(), above=(patch, haze), unevenness=0.0, seed=4))


def test_tip_at_a_bright_wall_is_refused():
    """A needle that goes behind a wall and does not come out has no tip there."""
    wall = SceneBar((60.0, 24.0), 1.5, 50.0, 240.0)
    with pytest.raises(MeasurementRefusedError, match="a wall may hide the tip"):
        locate(Scene(SceneNeedle(length_mm=45.0), above=(wall,), seed=4))


def test_hidden_tip_of_the_sheath_is_refused():
    """Where a wall hides the sheath's tip, it is not guessed."""
    wall = SceneBar((15.0, 24.0), 1.57, 6.0, 240.0)
    with pytest.raises(MeasurementRefusedError, match="the sheath's tip is hidden"):
        locate(Scene(SceneNeedle(), above=(wall,), seed=4))


@pytest.mark.parametrize("before", ["bright table", "dark table", "holder"])
def test_sheath_may_begin_inside_the_picture_at_an_edge(before):
    """With the gel's edge or a holder in view, the shaft that comes out of it is found."""
    needle = SceneNeedle(sheath_tip_mm=(30.0, 24.0), length_mm=30.0)
    require_ends(Scene(needle, edge_mm=24.0, edge_rad=0.04, before=before, seed=5))


def test_shaft_that_begins_in_plain_gel_is_refused():
    """Without an edge at its beginning, a bar inside the picture is not taken for the needle."""
    hidden = SceneBar((8.0, 24.0), np.pi / 2.0, 32.0, 165.0)
    scene = Scene(SceneNeedle(sheath_ratio=None), above=(hidden,), unevenness=0.0, seed=6)
    with pytest.raises(MeasurementRefusedError, match=r"the shaft begins|nothing dark"):
        locate(scene)


@pytest.mark.parametrize("width_mm", [1.0, 2.0, 3.5])
def test_dark_wall_beside_the_needle_is_no_second_shaft(width_mm):
    """A straight bar from border to border is a wall."""
    wall = SceneBar((40.0, 12.0), 0.02, width_mm, 60.0)
    require_ends(Scene(SceneNeedle(), below=(wall,), seed=7))


@pytest.mark.parametrize("angle_rad", [-0.9, -1.2, 1.57])
def test_wire_across_the_needle_changes_nothing(angle_rad):
    """A dark wire that crosses the needle at a wide angle does not divert the trace."""
    wire = SceneBar((33.0, 27.0), angle_rad, 1.0, 60.0)
    require_ends(Scene(SceneNeedle(), below=(wire,), seed=8))


def test_two_crossing_needles_are_refused():
    """Which of two needles is meant cannot be seen, also where one slants and they cross."""
    other = SceneNeedle((12.0, 37.0), heading_rad=-0.45, curvature_per_mm=0.0, length_mm=45.0)
    with pytest.raises(MeasurementRefusedError, match="two shafts"):
        locate(Scene(SceneNeedle(), others=(other,), seed=9))
