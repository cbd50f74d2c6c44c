"""The study of a design, beyond what tests/cli cover."""

import json
from pathlib import Path
from typing import Any

import pytest

from labrig.errors import InputError
from labrig.experiments.hinge_design.analysis import encode_design_file
from labrig.experiments.hinge_design.result import DesignResult
from labrig.needle.equations import RadiusTolerance

KEPT = Path(__file__).parents[2] / "records" / "design" / "analysis" / "001" / "result.json"


@pytest.fixture
def kept() -> dict[str, Any]:
    """The result of the kept design."""
    document: dict[str, Any] = json.loads(KEPT.read_text(encoding="utf-8"))
    return document


def test_the_table_holds_what_the_plane_leaves(kept: dict[str, Any]) -> None:
    """The residuals are those of the fitted plane, and each row holds the rotations of both hinges."""
    grid = DesignResult.model_validate(kept, strict=False).tables["grid"]
    assert len(grid) == len(kept["cells"])
    assert (grid["beta_rot_deg"] == grid["beta_a_deg"] + grid["beta_b_deg"]).all()
    assert (grid["residual_deg"] ** 2).mean() ** 0.5 == pytest.approx(kept["search"]["fit"]["rmse_deg"])


def test_hinges_that_might_not_turn_make_no_design_file(kept: dict[str, Any]) -> None:
    """A design whose radius has no upper limit has no design file."""
    study = DesignResult.model_validate(kept, strict=False)
    unbounded = study.model_copy(update={"tolerance": RadiusTolerance(-1.0, -1.0, 20.0, None)})
    with pytest.raises(InputError, match="no upper limit"):
        encode_design_file(unbounded, {})
