"""The study of a design, beyond what tests/cli cover."""

import pytest

from labrig.errors import AnswerIsNoError, InputError
from labrig.experiments.hinge_design.study import design_file, encode_hinge_table
from labrig.needle.design_search import GridPoint
from labrig.needle.equations import EQUATION_3

CELLS = tuple(
    GridPoint(d, cut, EQUATION_3.beta_rot_deg(cut, d) - 2.0, 2.0)
    for d in (0.01, 0.025, 0.04)
    for cut in (0.0, 4.0, 8.0)
)


def test_the_table_holds_what_the_plane_leaves() -> None:
    """Cells in the plane have a residual of zero, and each row holds the rotations of both hinges."""
    lines = encode_hinge_table(CELLS, EQUATION_3).decode().splitlines()
    assert len(lines) == 1 + len(CELLS)
    heads = lines[0].split(",")
    for line in lines[1:]:
        row = dict(zip(heads, line.split(","), strict=True))
        assert float(row["residual_deg"]) == pytest.approx(0.0, abs=1e-4)
        assert float(row["beta_b_deg"]) == 2.0


def test_hinges_that_might_not_turn_make_no_design_file() -> None:
    """A design whose radius has no upper limit has no design file."""
    document = {"accepted": True, "equation_3": {"same_tube": True}, "tolerance": {"radius_mm": [20.0, None]}}
    with pytest.raises(InputError, match="no upper limit"):
        design_file(document, {})


def test_a_study_that_found_nothing_makes_no_design_file() -> None:
    """Without an answer of equation (3) or the contour, the design file is refused with the contour's reason."""
    document = {"accepted": False, "search": {"reason": "on our contour no inclination gives 7 degrees"}}
    with pytest.raises(AnswerIsNoError, match="no inclination gives 7"):
        design_file(document, {})
