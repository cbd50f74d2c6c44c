"""The place and the heading at which the tip is searched for."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from labrig.devices.rig_file import load_rig
from labrig.needle.kinematics import rotation_x
from labrig.runner.sight import load_plane_map, load_tip_template
from labrig.steering.estimator import start_tip
from labrig.steering.tip_search import TipSearched, TipView, find_tip
from tests.steering.insertions import settings

SIMULATED = Path(__file__).parents[2] / "calibration" / "rig-simulated.yaml"


def _search(off_rad: float, misses: int, sd_mm: float = 0.2) -> TipSearched:
    """Look for the template's own tip in a grey picture, where it points elsewhere than expected, after misses."""
    rig = load_rig(SIMULATED)
    plane = load_plane_map(rig)
    template = load_tip_template(rig, plane)
    image, expected = np.full((720, 1280), int(np.median(template.picture)), np.uint8), np.eye(4)
    height, width = template.picture.shape
    image[300 : 300 + height, 350 : 350 + width] = template.picture
    expected[1:3, 3] = plane.to_mm(np.add([template.tip_px], (350, 300)))[0]
    expected[:3, :3] = rotation_x(-template.heading_rad - off_rad)
    tip = replace(start_tip(np.eye(4), settings(planar=True, observation_sd_mm=sd_mm)), misses=misses)
    return find_tip(TipView(plane, template), image, expected, tip, template.roll_rad)


@pytest.mark.processors
def test_a_tip_that_points_elsewhere_is_found_again_after_two_misses():
    """After two misses every heading is tried, so that a tip deflected by a cavity is found."""
    assert _search(0.0, misses=0).position_mm is not None
    assert _search(math.radians(25), misses=0).position_mm is None
    assert _search(math.radians(25), misses=2).position_mm is not None


@pytest.mark.parametrize(
    ("sd_mm", "misses", "region_px"),
    [
        (0.01, 0, 43 + 2 * 12),
        (1.0, 0, 43 + 2 * 4 / 0.10534),
        (0.01, 1, 67 * 1.6),
        (0.01, 16, 67 * 1.6**16),
        (0.01, 17, 67 * 1.6**16),
    ],
)
def test_the_less_is_known_of_a_tip_the_wider_it_is_searched_for(sd_mm, misses, region_px):
    """Beyond the template's 43 px, by four standard deviations and 12 px at least; more, the longer it is unseen."""
    assert _search(0.0, misses, sd_mm).region_px == pytest.approx(region_px, rel=1e-4)
