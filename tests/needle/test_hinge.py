"""The contour of a hinge."""

import math
from dataclasses import replace

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from labrig.errors import InputError
from labrig.needle.hinge import Hinge, widest_clearance_mm
from labrig.needle.rotation_search import interference_mm2, search_largest_rotation
from labrig.protocol.design_file import PAPER_TUBE
from tests.needle.no_fit import NoFit, make_tube

PAPER = Hinge(PAPER_TUBE, 0.025, 4.13)

hinges = st.builds(
    lambda outer, bore, share, cut: Hinge(
        make_tube(outer, bore * outer, 3 * outer),
        share * widest_clearance_mm(make_tube(outer, bore * outer, 3 * outer), cut),
        cut,
    ),
    outer=st.floats(0.6, 3.0),
    bore=st.floats(0.4, 0.8),
    share=st.floats(0.1, 0.95),
    cut=st.floats(0.0, 8.0),
)


@given(hinge=hinges)
@settings(max_examples=40)
def test_links_at_rest_are_a_clearance_apart(hinge: Hinge) -> None:
    """Both links are valid polygons, nowhere closer than the clearance, except for the chords of arcs."""
    links = hinge.links
    assert links.knuckle.is_valid
    assert links.socket.is_valid
    chord_mm = 0.001 * hinge.knuckle_radius_mm
    assert links.knuckle.distance(links.socket) == pytest.approx(hinge.clearance_mm, abs=chord_mm)


@given(hinge=hinges)
@settings(max_examples=20)
def test_links_are_mirror_images_of_themselves(hinge: Hinge) -> None:
    """Both links look the same from both sides, so one direction of rotation is enough."""
    for link in (hinge.links.knuckle, hinge.links.socket):
        mirrored = shapely.transform(link, lambda points: points * (-1, 1))
        assert shapely.symmetric_difference(link, mirrored).area < 1e-9


@given(hinge=hinges)
@settings(max_examples=20)
def test_the_lips_hold_the_knuckle(hinge: Hinge) -> None:
    """The links come apart by `pull_out_mm`, no further, in both views."""
    play_mm = hinge.pull_out_mm
    for view in (hinge.hinge_a(), hinge.hinge_b()):
        poses = np.array([[0.0, 0.0], [0.0, 0.0], [0.98 * play_mm, 1.02 * play_mm]])
        shared = interference_mm2(view, poses)
        assert shared[0] == 0.0
        assert shared[1] > 0.0


@pytest.mark.parametrize(
    ("clearance_mm", "beta_cut_deg", "link_mm", "message"),
    [
        (30.0, 4.0, 3.0, r"laser clearance is 30 mm, and has to be at most 0\.07292 mm"),
        (0.0, 4.0, 3.0, "laser clearance is 0 mm, and has to be at least"),
        (0.0005, 4.0, 3.0, "laser clearance"),
        (math.nan, 4.0, 3.0, "laser clearance"),
        (0.025, 30.0, 3.0, "cutting inclination.*at most 29"),
        (0.025, -1.0, 3.0, "cutting inclination.*at least 0"),
        (0.025, math.nan, 3.0, "cutting inclination.*nan"),
        (0.025, 4.0, 0.8, r"link length is 0\.8 mm, and has to be at least 0\.928 mm"),
    ],
)
def test_a_hinge_that_cannot_be_cut_is_refused(
    clearance_mm: float, beta_cut_deg: float, link_mm: float, message: str
) -> None:
    """A knuckle that slips out, lips cut through, and two ends that meet: each with its value and limit."""
    with pytest.raises(InputError, match=message):
        Hinge(make_tube(1.2, 0.7, link_mm), clearance_mm, beta_cut_deg)


def test_two_sections_decide_hinge_b() -> None:
    """With thirty sections more, which can only stop it earlier, hinge b still turns to within 0.005 degrees."""
    view = PAPER.hinge_b()
    more = (PAPER.section(float(depth)) for depth in np.linspace(0.001, 0.59, 30))
    denser = replace(view, sections=(*view.sections, *more))
    assert NoFit(denser).is_free(search_largest_rotation(view).rotation_deg - 0.005)
