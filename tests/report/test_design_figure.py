"""Figure 3 and its table."""

import pytest

from labrig.needle import EQUATION_3, Cell
from labrig.report import hinge_figure, hinge_table

CELLS = tuple(
    Cell(d, cut, EQUATION_3.beta_rot_deg(cut, d) - 2.0, 2.0)
    for d in (0.01, 0.025, 0.04)
    for cut in (0.0, 4.0, 8.0)
)


@pytest.mark.parametrize(
    ("picture_format", "start"), [("png", b"\x89PNG"), ("svg", b"<?xml"), ("pdf", b"%PDF")]
)
def test_the_same_cells_give_the_same_bytes(picture_format: str, start: bytes) -> None:
    """The figure is drawn in the format asked for, and again the same to the byte."""
    first = hinge_figure(CELLS, EQUATION_3, picture_format)
    assert first.startswith(start)
    assert hinge_figure(CELLS, EQUATION_3, picture_format) == first


def test_the_table_holds_what_the_plane_leaves() -> None:
    """Cells that lie in the plane leave nothing, and each line carries both hinges' rotations."""
    lines = hinge_table(CELLS, EQUATION_3).decode().splitlines()
    assert len(lines) == 1 + len(CELLS)
    heads = lines[0].split(",")
    for line in lines[1:]:
        row = dict(zip(heads, line.split(","), strict=True))
        assert float(row["residual_deg"]) == pytest.approx(0.0, abs=1e-4)
        assert float(row["beta_b_deg"]) == 2.0
