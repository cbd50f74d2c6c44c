"""The hinge in section, and figure 3."""

import numpy as np
import pytest

from labrig.experiments.hinge_design.figure import draw_hinge_figure, draw_section
from labrig.needle.equations import EQUATION_3
from labrig.needle.hinge import Hinge
from labrig.needle.rotation_search import GridPoint
from labrig.protocol.design_file import PAPER_TUBE

CELLS = tuple(GridPoint(d, cut, 8.0 + cut, 2.0) for d in (0.01, 0.025, 0.04) for cut in (0.0, 4.0, 8.0))


def test_both_planes_are_named() -> None:
    """The legend tells our contour from equation (3)."""
    drawn = draw_hinge_figure(CELLS, EQUATION_3, "rotations")
    assert ("equation (3)" in drawn, "our contour" in drawn) == (True, True)


def test_the_section_shows_both_links_with_the_laser_between_them() -> None:
    """Along the axis the knuckle's top is a clearance below the crown of the socket; both sizes are written."""
    drawn = draw_section(Hinge(PAPER_TUBE, 0.025, 3.33), "section")
    knuckle, socket = (
        np.asarray(patch.get_path().vertices, float) for patch in drawn.figure.axes[0].patches[:2]
    )
    crown_mm = min(z for x, z in socket if abs(x) < 0.01 and 0.0 < z < 1.0)
    assert crown_mm - max(z for _, z in knuckle) == pytest.approx(0.025, abs=1e-3)
    assert "clearance 0.025 mm" in drawn
    assert "3.33°" in drawn
