"""Figure 3."""

import pytest

from labrig.experiments.hinge_design.figure import draw_hinge_figure
from labrig.needle.design_search import GridPoint
from labrig.needle.equations import EQUATION_3

CELLS = tuple(
    GridPoint(d, cut, EQUATION_3.beta_rot_deg(cut, d) - 2.0, 2.0)
    for d in (0.01, 0.025, 0.04)
    for cut in (0.0, 4.0, 8.0)
)


@pytest.mark.parametrize(
    ("picture_format", "start"), [("png", b"\x89PNG"), ("svg", b"<?xml"), ("pdf", b"%PDF")]
)
def test_the_same_cells_give_the_same_bytes(picture_format: str, start: bytes) -> None:
    """The figure has the requested format, and the same data give the same bytes."""
    first = draw_hinge_figure(CELLS, EQUATION_3, picture_format)
    assert first.startswith(start)
    assert draw_hinge_figure(CELLS, EQUATION_3, picture_format) == first
