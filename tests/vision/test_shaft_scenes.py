"""The shaft among walls, wide sheaths, gel edges and other shafts, in scenes whose ends are known."""

from dataclasses import replace

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


@pytest.mark.parametrize(
    ("at_mm", "width_mm", "level", "opacity"),
    [(33.0, 2.5, 240.0, 1.0), (33.0, 4.0, 240.0, 0.8), (33.0, 6.0, 240.0, 1.0), (30.0, 4.0, 165.0, 1.0),
     (40.0, 8.0, 165.0, 1.0)],
)  # fmt: skip
def test_needle_goes_on_behind_what_hides_a_stretch_of_it(at_mm, width_mm, level, opacity):
    """A bright wall, or what is as grey as gel, does not end the needle where the rest is plain to the eye."""
    hiding = SceneBar((at_mm, 24.0), 1.5, width_mm, level, opacity)
    require_ends(Scene(SceneNeedle(), above=(hiding,), unevenness=0.25 if level > 200.0 else 0.0, seed=4))


def test_gel_beside_a_bright_wall_is_no_needle():
    """A needle that ends before a wall along it ends there, although gel looks dark between the wall and its edge."""
    needle = SceneNeedle((12.8, 25.6), 0.02, -0.0323, 18.3, sheath_ratio=1.5, glint=0.2)
    wall = SceneBar((40.0, 17.9), -0.025, 3.4, 240.0, 0.85)
    require_ends(Scene(needle, px_per_mm=12.9, width_px=1119, height_px=630, below=(wall,), seed=4))


@pytest.mark.parametrize("opacity", [0.6, 0.75, 0.85])
def test_an_end_beyond_which_the_needle_goes_on_is_refused(opacity):
    """Behind a stretch that is not seen the needle is too pale to be measured, and plain to the eye: it has no tip."""
    patch, haze = SceneBar((34.0, 24.0), 1.5, 8.0, 165.0), SceneBar((60.0, 24.0), 1.5, 44.0, 165.0, opacity)
    with pytest.raises(MeasurementRefusedError, match=r"the shaft is lost at .* but goes on"):
        locate(Scene(SceneNeedle(), above=(patch, haze), unevenness=0.0, seed=4))


@pytest.mark.parametrize("before", ["bright table", "dark table", "holder"])
def test_sheath_may_begin_inside_the_picture_at_an_edge(before):
    """With the gel's edge or a holder in view, the shaft that comes out of it is found."""
    needle = SceneNeedle(sheath_tip_mm=(30.0, 24.0), length_mm=30.0)
    require_ends(Scene(needle, edge_mm=24.0, edge_rad=0.04, before=before, seed=5))


HIDDEN_START = SceneBar((8.0, 24.0), np.pi / 2.0, 32.0, 165.0)
RUNNING_IN = SceneNeedle((10.56, 27.07), -0.223, 0.0, 46.6, level=53.0, glint=0.74)
CROSSING = SceneNeedle((12.0, 37.0), heading_rad=-0.45, curvature_per_mm=0.0, length_mm=45.0)


@pytest.mark.parametrize(
    ("scene", "words"),
    [
        (
            Scene(SceneNeedle(sheath_ratio=None), above=(HIDDEN_START,), unevenness=0.0),
            "the shaft begins|nothing dark",
        ),
        (
            Scene(SceneNeedle(), above=(SceneBar((15.0, 24.0), 1.57, 6.0, 240.0),)),
            "the sheath's tip is hidden",
        ),
        (
            Scene(SceneNeedle(length_mm=45.0), above=(SceneBar((60.0, 24.0), 1.5, 50.0, 240.0),)),
            "may hide the tip",
        ),
        (Scene(SceneNeedle(), others=(CROSSING,)), "two shafts"),
        (
            Scene(
                SceneNeedle((13.5, 25.9), 0.013, -0.0277, 36.3, sheath_ratio=1.73, level=70.0, glint=0.4),
                px_per_mm=11.4,
                width_px=991,
                height_px=558,
                others=(RUNNING_IN,),
            ),
            "something lies over it",
        ),
    ],
    ids=[
        "begins in plain gel",
        "hidden sheath's tip",
        "tip at a wall",
        "crossing needles",
        "one on top of another",
    ],
)
def test_a_needle_of_which_an_end_is_not_seen_is_refused(scene, words):
    """What is hidden is not guessed, and of two needles it cannot be seen which is meant."""
    with pytest.raises(MeasurementRefusedError, match=words):
        locate(replace(scene, seed=4))


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
