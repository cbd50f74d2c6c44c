"""`labrig design`: from a radius to a cut."""

from typing import Any

import pytest

from labrig.cli.finished_run import print_summary
from labrig.experiments.hinge_design.protocol import DesignProtocol, MeasuredNeedle
from labrig.experiments.hinge_design.study import study_design
from labrig.experiments.hinge_design.summary import summarise
from labrig.needle.rotation_search import DEFAULT_SEED
from labrig.protocol.design_file import PAPER_TUBE, Tube
from tests.cli.conftest import Labrig


@pytest.fixture(scope="module")
def designed() -> dict[str, Any]:
    """Return the document of the paper's needle with a measured radius, on a coarse grid."""
    design = DesignProtocol(
        experiment="design",
        radius_mm=30.0,
        clearance_mm=0.025,
        measured=MeasuredNeedle(radius_mm=27.6),
        grid_points=3,
        seed=DEFAULT_SEED,
    )
    return study_design(design).model_dump(mode="json")


def test_the_answer_is_that_of_table_1_and_of_our_search(
    designed: dict[str, Any], capsys: pytest.CaptureFixture[str]
) -> None:
    """Equation (3) gives 4.12 degrees next to table I's 4.13; our contour needs less for the same rotation."""
    search, measured = designed["search"], designed["measured"]
    assert Tube(**designed["tube"]) == PAPER_TUBE
    assert (designed["beta_rot_deg"], designed["beta_cut_deg"]) == pytest.approx((11.46, 4.12), abs=0.005)
    assert search["beta_rot_deg"] == pytest.approx(designed["beta_rot_deg"], abs=0.005)
    assert search["beta_cut_deg"] == pytest.approx(3.33, abs=0.02)
    assert search["fit"]["a"] == pytest.approx(1.10, abs=0.01)
    assert set(search["fit"]) == {"a", "b", "c", "rmse_deg"}
    assert (len(designed["cells"]), search["inside_grid"]) == (9, True)
    assert (measured["beta_cut_deg"], measured["beta_rot_deg"]) == (
        4.13,
        pytest.approx(343.77 / 27.6, abs=0.01),
    )
    assert measured["clearance_mm"] == pytest.approx(0.0283, abs=0.002)
    assert measured["search_clearance_mm"] > 0
    assert designed["tolerance"]["low_mm"] < 28 < 32 < designed["tolerance"]["high_mm"]
    print_summary(summarise(designed))
    text = capsys.readouterr().out
    for part in ("4.12", "3.33", "Table I prints 4.13", "Measured", "not for cutting"):
        assert part in text


@pytest.mark.parametrize(
    ("arguments", "exit_code", "words"),
    [
        (["--clearance-mm", "30"], 2, "give a value from 0.001"),
        (["--clearance-mm", "0"], 2, "laser clearance is 0 mm"),
        (["--clearance-mm", "nan"], 2, "--clearance-mm is nan"),
        (["--radius-mm", "0.03"], 2, "0.03 m is 30 mm"),
        (["--radius-mm", "7"], 2, "cuts the socket's lips through"),
        (["--radius-mm", "200"], 1, "no inclination gives"),
    ],
)
def test_bad_input_is_refused_before_the_search(
    arguments: list[str], exit_code: int, words: str, labrig: Labrig
) -> None:
    """An impossible design is refused with the limit and a remedy."""
    done = labrig("design", *arguments)
    assert (done.exit_code, words in done.err) == (exit_code, True)
