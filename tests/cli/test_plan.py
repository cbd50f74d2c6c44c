"""`labrig plan`: a path for a scenario, and a figure of it, without any rig."""

import json
from pathlib import Path

import pytest

from tests.cli.conftest import Labrig

SCENARIO = {
    "needle": {"radius_mm": 27.6, "diameter_mm": 1.2},
    "target": {"position_mm": [0, 5, 100], "tolerance_mm": 2},
    "obstacles": [{"position_mm": [0, -2, 35], "radius_mm": 8}, {"position_mm": [0, 6, 68], "radius_mm": 8}],
    "planar": True,
    "clearance_mm": 0.6,
    "max_arcs": 6,
    "max_length_mm": 130,
}


def _file(tmp_path: Path, **changes: object) -> Path:
    path = tmp_path / "scenario.json"
    path.write_text(json.dumps({**SCENARIO, **changes}), encoding="utf-8")
    return path


@pytest.mark.parametrize("method", ["best", "paper"])
def test_a_plan_is_one_document(labrig: Labrig, tmp_path: Path, method: str) -> None:
    """Under --json the plan has every documented key, and keeps what the scenario asks."""
    done = labrig("plan", _file(tmp_path, method=method), "--json")
    plan = done.json()
    assert done.exit_code == 0
    assert plan["found"] is True
    assert plan["reason"] is None
    assert plan["clearance_mm"] >= 0.6
    assert plan["target_error_mm"] <= 2
    assert plan["length_mm"] == pytest.approx(sum(arc["length_mm"] for arc in plan["arcs"]))
    assert set(plan["arcs"][0]) == {"roll_rad", "angle_rad", "length_mm"}
    assert len(plan["tip_mm"]) == 3
    assert plan["elapsed_s"] > 0


@pytest.mark.parametrize(("name", "magic"), [("plan.svg", b"<?xml"), ("plan.png", b"\x89PNG")])
@pytest.mark.parametrize("planar", [True, False])
def test_a_plan_is_drawn(labrig: Labrig, tmp_path: Path, name: str, magic: bytes, planar: bool) -> None:
    """--figure draws the plan as SVG or PNG, and an existing figure is never replaced."""
    scenario = _file(tmp_path, planar=planar)
    done = labrig("plan", scenario, "--figure", tmp_path / name)
    assert done.exit_code == 0
    assert "length mm" in done.out
    assert (tmp_path / name).read_bytes().startswith(magic)
    assert labrig("plan", scenario, "--figure", tmp_path / name).exit_code == 2


def test_no_plan_is_an_answer(labrig: Labrig, tmp_path: Path) -> None:
    """An unreachable target exits with 1 and the reason; the scenario is drawn all the same."""
    scenario = _file(tmp_path, target={"position_mm": [0, 0, -20]})
    done = labrig("plan", scenario, "--json", "--figure", tmp_path / "no.svg")
    assert done.exit_code == 1
    assert done.json()["found"] is False
    assert "behind" in done.json()["reason"]
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


BAD = {
    "NaN": {"clearance_mm": float("nan")},
    "a zero radius": {"needle": {"radius_mm": 0, "diameter_mm": 1.2}},
    "a negative obstacle": {"obstacles": [{"position_mm": [0, 0, 50], "radius_mm": -3}]},
    "a start inside an obstacle": {"obstacles": [{"position_mm": [0, 1, 1], "radius_mm": 3}]},
    "a target inside an obstacle": {"obstacles": [{"position_mm": [0, 5, 99], "radius_mm": 3}]},
    "an unknown method": {"method": "magic"},
    "an unknown key": {"clearence_mm": 1},
    "a point of two numbers": {"target": {"position_mm": [0, 100]}},
    "half a tolerance": {"needle": {"radius_mm": 30, "diameter_mm": 1.2, "radius_range_mm": [28]}},
    "a radius outside of its tolerance": {
        "needle": {"radius_mm": 30, "diameter_mm": 1.2, "radius_range_mm": [31, 33]}
    },
    "a start that is no rotation": {"start": {"rotation": [[1, 0, 0], [0, 1, 0], [0, 0, 2]]}},
}


@pytest.mark.parametrize("change", BAD.values(), ids=BAD.keys())
def test_a_bad_scenario_is_refused(labrig: Labrig, tmp_path: Path, change: dict[str, object]) -> None:
    """An invalid scenario exits with 2 and a message, without a plan."""
    done = labrig("plan", _file(tmp_path, **change), "--json")
    assert done.exit_code == 2
    assert done.json()["error"]["message"]
    assert "Traceback" not in done.err
