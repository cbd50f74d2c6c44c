"""The study of a design, beyond what tests/cli cover."""

import json
from pathlib import Path

import pytest

from labrig.errors import InputError
from labrig.experiments.hinge_design.result import DesignResult, DesignStudy, Searched
from labrig.experiments.hinge_design.study import encode_design_file
from labrig.needle.equations import EQUATION_3, RadiusTolerance
from labrig.needle.rotation_search import GridPoint
from labrig.protocol.design_file import PAPER_TUBE

CELLS = tuple(
    GridPoint(d, cut, EQUATION_3.beta_rot_deg(cut, d) - 2.0, 2.0)
    for d in (0.01, 0.025, 0.04)
    for cut in (0.0, 4.0, 8.0)
)


def test_the_table_holds_what_the_plane_leaves() -> None:
    """Cells in the plane have a residual of zero, and each row holds the rotations of both hinges."""
    kept = json.loads((Path(__file__).parents[2] / "records/design/analysis/001/result.json").read_text())
    grid = DesignResult.model_validate(kept, strict=False).tables["grid"]
    assert len(grid) == len(kept["cells"])
    assert (grid["beta_rot_deg"] == grid["beta_a_deg"] + grid["beta_b_deg"]).all()
    assert (grid["residual_deg"] ** 2).mean() ** 0.5 == pytest.approx(kept["search"]["fit"]["rmse_deg"])


def test_hinges_that_might_not_turn_make_no_design_file() -> None:
    """A design whose radius has no upper limit has no design file."""
    study = DesignStudy(
        accepted=True,
        beta_cut_deg=4.12,
        beta_rot_deg=11.46,
        radius_mm=30.0,
        clearance_mm=0.025,
        tube=PAPER_TUBE,
        tolerance=RadiusTolerance(-1.0, -1.0, 20.0, None),
        measured=None,
        search=Searched(fit=EQUATION_3),
        cells=CELLS,
    )
    with pytest.raises(InputError, match="no upper limit"):
        encode_design_file(study, {})
