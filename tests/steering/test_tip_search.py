"""The place and the heading at which the tip is searched for."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from labrig.devices.rig_file import load_rig
from labrig.experiments.declared import PROTOCOL_MODELS
from labrig.experiments.insertion.aim import make_aim
from labrig.experiments.insertion.protocol import InsertionProtocol
from labrig.experiments.insertion.settings import make_insertion_settings
from labrig.protocol.load import load_protocol
from labrig.runner.sight import load_plane_map, load_tip_template
from labrig.steering.step import start_steering
from labrig.steering.tip_search import TipSearched, TipView, find_tip
from tests.runner.sessions import PROTOCOLS

SIMULATED = Path(__file__).parents[2] / "calibration" / "rig-simulated.yaml"


def _search(off_rad: float, misses: int) -> TipSearched:
    """Look for a tip that stands 20 mm deep and points elsewhere than expected, after so many misses."""
    protocol = load_protocol(PROTOCOLS / "insertion.yaml", PROTOCOL_MODELS)
    assert isinstance(protocol, InsertionProtocol)
    rig = load_rig(SIMULATED)
    plane = load_plane_map(rig)
    view = TipView(plane, load_tip_template(rig, plane))
    aim = make_aim(protocol, view.plane)
    state, _ = start_steering(make_insertion_settings(protocol, aim.target_mm, aim.obstacles))
    image, (y_mm, z_mm) = _picture(view)
    heading_rad = view.template.heading_rad + off_rad
    expected = np.eye(4)
    expected[1:3, 3] = y_mm, z_mm
    expected[1:3, 1:3] = (
        (math.cos(heading_rad), math.sin(heading_rad)),
        (-math.sin(heading_rad), math.cos(heading_rad)),
    )
    return find_tip(view, image, expected, replace(state.tip, misses=misses), view.template.roll_rad)


def _picture(view: TipView) -> tuple[np.ndarray[tuple[int, ...], np.dtype[np.uint8]], tuple[float, float]]:
    """Return a grey picture with the template's own tip in it, and where that is in the plane."""
    patch = view.template.picture
    image = np.full((720, 1280), int(np.median(patch)), np.uint8)
    u, v = 350, 300
    image[v : v + patch.shape[0], u : u + patch.shape[1]] = patch
    tip_px = np.array([[u + view.template.tip_px[0], v + view.template.tip_px[1]]])
    y_mm, z_mm = view.plane.to_mm(tip_px)[0].tolist()
    return image, (y_mm, z_mm)


@pytest.mark.processors
def test_a_tip_that_points_elsewhere_is_found_again_after_two_misses() -> None:
    """After two misses every heading is tried, so that a tip deflected by a cavity is found."""
    assert _search(0.0, misses=0).position_mm is not None
    assert _search(math.radians(25), misses=0).position_mm is None
    assert _search(math.radians(25), misses=2).position_mm is not None
