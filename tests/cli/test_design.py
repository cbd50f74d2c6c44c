"""`labrig plan` and `labrig run protocols/design.yaml`: paths and cuts without a rig; `test_refusals` has refusals."""

import json
import shutil
from pathlib import Path
from typing import Any

import pytest

from labrig.experiments.hinge_design.result import DesignResult, list_findings, list_warnings
from labrig.protocol.design_file import PAPER_TUBE, Tube, load_design
from labrig.record.reader import open_run
from tests.cli.conftest import ROOT, SCENARIO, Labrig
from tests.cli.example_runs import of_protocol
from tests.protocol.designs import sweep_with


def _file(tmp_path: Path, **changes: object) -> Path:
    path = tmp_path / "scenario.json"
    path.write_text(json.dumps({**SCENARIO, **changes}), encoding="utf-8")
    return path


@pytest.mark.parametrize("method", ["best", "paper"])
def test_a_plan_is_one_document(labrig: Labrig, tmp_path: Path, method: str) -> None:
    """Under --json the plan has every documented key, and keeps what the scenario asks."""
    done = labrig("plan", _file(tmp_path, method=method), "--json")
    plan = done.json()
    assert (done.exit_code, plan["found"], plan["reason"]) == (0, True, None)
    assert plan["clearance_mm"] >= 0.6
    assert plan["target_error_mm"] <= 2
    assert plan["length_mm"] == pytest.approx(sum(arc["length_mm"] for arc in plan["arcs"]))
    assert set(plan["arcs"][0]) == {"roll_rad", "angle_rad", "length_mm"}
    assert len(plan["tip_mm"]) == 3
    assert plan["elapsed_s"] > 0


@pytest.mark.parametrize(
    ("name", "magic", "planar"), [("plan.svg", b"<?xml", True), ("plan.png", b"\x89PNG", False)]
)
def test_a_plan_is_drawn(labrig: Labrig, tmp_path: Path, name: str, magic: bytes, planar: bool) -> None:
    """--figure draws the plan as SVG or PNG, and an existing figure is never replaced."""
    scenario = _file(tmp_path, planar=planar)
    done = labrig("plan", scenario, "--figure", tmp_path / name)
    assert (done.exit_code, "turn degrees  angle degrees  length mm" in done.out) == (0, True)
    assert (tmp_path / name).read_bytes().startswith(magic)
    assert labrig("plan", scenario, "--figure", tmp_path / name).exit_code == 2


def test_no_plan_is_an_answer(labrig: Labrig, tmp_path: Path) -> None:
    """An unreachable target exits with 1 and the reason; the scenario is drawn all the same."""
    scenario = _file(tmp_path, target={"position_mm": [0, 0, -20]})
    done = labrig("plan", scenario, "--json", "--figure", tmp_path / "no.svg")
    plan = done.json()
    assert (done.exit_code, plan["found"], plan["arcs"], plan["tip_mm"]) == (1, False, [], None)
    assert "behind" in plan["reason"]
    assert (tmp_path / "no.svg").is_file()
    assert "no path: the target" in labrig("plan", scenario).out


def test_a_path_allows_for_the_tolerance_of_the_radius(labrig: Labrig, tmp_path: Path) -> None:
    """Its worst error is printed."""
    needle = {"radius_mm": 30.0, "diameter_mm": 1.4, "radius_range_mm": [28.0, 32.5]}
    plan = labrig("plan", _file(tmp_path, needle=needle), "--json").json()
    for arc in plan["arcs"]:
        assert arc["length_mm"] == pytest.approx(30.0 * arc["angle_rad"])
    assert plan["target_error_mm"] < plan["worst_target_error_mm"]
    assert plan["worst_clearance_mm"] < plan["clearance_mm"]
    assert "worst radius" in labrig("plan", _file(tmp_path, needle=needle)).out
    del needle["radius_range_mm"]
    assert labrig("plan", _file(tmp_path, needle=needle), "--json").json()["worst_target_error_mm"] is None


KEPT = ROOT / "tests" / "records" / "design"
"""The paper's needle with a measured radius, on a coarse grid; `test_every_verb` computes it again."""


def test_the_answer_is_that_of_table_1_and_of_our_search(labrig: Labrig, tmp_path: Path) -> None:
    """Equation (3) gives 4.12 degrees next to table I's 4.13, our contour less; record, design file and page say so."""
    run = open_run(shutil.copytree(KEPT, tmp_path / "design"))
    found: dict[str, Any] = json.loads((run.path / "analysis" / "001" / "result.json").read_text())
    search, measured, tolerance = found["search"], found["measured"], found["tolerance"]
    assert Tube(**found["tube"]) == PAPER_TUBE
    assert (found["beta_rot_deg"], found["beta_cut_deg"]) == pytest.approx((11.46, 4.12), abs=0.005)
    assert search["beta_rot_deg"] == pytest.approx(found["beta_rot_deg"], abs=0.005)
    assert search["beta_cut_deg"] == pytest.approx(3.33, abs=0.02)
    assert (search["fit"]["a"], search["inside_grid"]) == (pytest.approx(1.10, abs=0.01), True)
    assert (set(search["fit"]), len(found["cells"])) == ({"a", "b", "c", "rmse_deg"}, 9)
    assert measured["beta_rot_deg"] == pytest.approx(343.77 / 27.6, abs=0.01)
    assert (measured["beta_cut_deg"], measured["clearance_mm"]) == (4.13, pytest.approx(0.0283, abs=0.002))
    assert tolerance["low_mm"] < 28 < 32 < tolerance["high_mm"]
    design = load_design(run.path / "analysis" / "001" / "design.json")
    assert (design.radius_mm, design.tube.outer_diameter_mm, design.basis) == (30.0, 1.2, "equation (3)")
    assert [design.radius_low_mm, design.radius_high_mm] == [tolerance["low_mm"], tolerance["high_mm"]]
    assert design.beta_cut_deg == found["beta_cut_deg"]
    assert (run.damage, len(run.pictures), run.devices) == ((), 0, {})
    assert not (run.path / "rig.yaml").exists()
    assert list(run.events["kind"]) == ["run_start", "run_stop"]
    content = DesignResult.model_validate(found, strict=False)
    text = " ".join((*list_findings(content), *list_warnings(content)))
    words = ("4.12", "3.33", "Table I of the paper has 4.13", "as measured, 27.6 mm", "not for cutting")
    assert [part for part in words if part not in text] == []
    assert labrig("report", run.path).exit_code == 0
    page = (run.path / "report.html").read_text(encoding="utf-8")
    for part in ("Rotation of two adjacent hinges", "4.12", "4.13", "3.33", "26.90 to 33.90", "grid.csv", "design.json",
                 "do not correct", "does not reproduce the slope with the clearance", "no cutting file"):  # fmt: skip
        assert part in page
    assert "simulated rig" not in page


@pytest.mark.slow
def test_a_radius_that_our_contour_cannot_give_has_equation_3s_answer_if_it_applies(
    labrig: Labrig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """For 45 mm at 0.025 mm with the reason; of another tube the answer is a no: code 1, a page, no design file."""
    monkeypatch.setenv("LABRIG_RIG", str(tmp_path / "no-such-rig.yaml"))
    protocol = (ROOT / "protocols" / "design.yaml", "--set", "grid_points=3", "--set", "radius_mm=45")
    tube = "tube={outer_diameter_mm: 1.1, inner_diameter_mm: 0.6, link_length_mm: 3}"
    for name, more in (("paper", ()), ("other", ("--set", tube, "--set", "measured=null"))):
        done = labrig("run", *protocol, *more, "--runs-dir", tmp_path, "--run-name", name, "--json")
        document, applies = done.json(), name == "paper"
        result, page = document["result"], Path(document["report"]).read_text(encoding="utf-8")
        file = tmp_path / name / "analysis" / "001" / "design.json"
        assert (done.exit_code, document["exit_status"], file.exists()) == (1 - applies, "success", applies)
        assert (result["search"]["beta_cut_deg"], result["search"]["tolerance"]) == (None, None)
        if applies:
            assert result["beta_cut_deg"] == pytest.approx(0.62, abs=0.01)
            assert load_design(file).radius_mm == 45.0
            assert "on our contour no inclination gives 7.639 degrees" in result["search"]["reason"]
            assert [word in page for word in ("on our contour no", "nothing of this range")] == [True] * 2
        else:
            assert (result["accepted"], "nothing to cut" in page) == (False, True)


def test_a_sweep_takes_the_design_of_a_run(labrig: Labrig, tmp_path: Path) -> None:
    """Its needle comes from design.json, and the world draws a radius within the tolerance."""
    file = shutil.copytree(KEPT, tmp_path / "runs" / "design") / "analysis" / "001" / "design.json"
    sweep = sweep_with(tmp_path / "protocols", "  design_file: ../runs/design/analysis/001/design.json\n")
    gel = ("--set", "rig.world.gels=[{gelatin_percent: 13, radius_mean_mm: 28.34, radius_sd_mm: 0}]")
    words = (*of_protocol("steerability")[1:], *gel, "--runs-dir", tmp_path / "swept", "--json")
    done = labrig("run", sweep, *words)
    assert done.exit_code == 0
    run, design = open_run(done.json()["run"]), load_design(file)
    (drawn_mm,) = run.truth["radius_mm"]
    assert design.radius_low_mm < drawn_mm * 30 / 28.34 < design.radius_high_mm
    assert drawn_mm != 28.34
    assert run.protocol["needle"]["design_radius_mm"] == 30.0
    page = Path(done.json()["report"]).read_text(encoding="utf-8")
    assert ("within tolerance" in page, "Of the gel" in page) == (True, False)
