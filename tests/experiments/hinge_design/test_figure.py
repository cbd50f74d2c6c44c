"""The hinge in section, and figure 3."""

import numpy as np
import pytest

from labrig.experiments.hinge_design.figure import draw_hinge_figure, draw_section
from labrig.experiments.hinge_design.result import DesignResult
from labrig.needle.hinge import Hinge
from labrig.protocol.design_file import PAPER_TUBE
from tests.cli.conftest import ROOT

KEPT = ROOT / "tests" / "records" / "design" / "analysis" / "001" / "result.json"


def test_the_design_stands_among_both_planes_with_its_radius() -> None:
    """The legend tells our contour from equation (3); the star is the design, and the right axis tells radii."""
    drawn = draw_hinge_figure(DesignResult.model_validate_json(KEPT.read_text(), strict=False), "rotations")
    for words in ("equation (3)", "our contour", "this design", "radius (mm)"):
        assert words in drawn
    (axes,) = drawn.figure.axes
    star = next(line for line in axes.lines if line.get_marker() == "*")
    assert np.asarray(star.get_data()).ravel().tolist() == pytest.approx([0.025, 11.46], abs=0.005)
    (radius,) = axes.child_axes
    assert radius.yaxis.get_transform().inverted().transform(30.0) == pytest.approx(11.46, abs=0.005)


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
