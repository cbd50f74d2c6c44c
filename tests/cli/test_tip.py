"""`labrig calibrate template` and `labrig measure tip`."""

import json
import math
from pathlib import Path

import pytest

from tests.cli.conftest import Labrig, SweepRun


@pytest.fixture
def finals(sweep: SweepRun) -> list[Path]:
    """Return the final pictures of a sweep."""
    lines = [json.loads(line) for line in (sweep.run / "frames.jsonl").read_text().splitlines()]
    return [sweep.run / line["file"] for line in lines if line["role"] == "final"]


def test_a_template_of_one_frame_finds_the_tips_of_others(
    labrig: Labrig, sweep: SweepRun, finals: list[Path], tmp_path: Path
) -> None:
    """Where their shafts end; near a place that is given, and not elsewhere. Only --force replaces a picture."""
    template = tmp_path / "tip.png"
    cut = ("calibrate", "template", sweep.run, "--out", template)
    made = labrig(*cut, "--json")
    assert (made.exit_code, abs(made.json()["heading_deg"]) < 90) == (0, True)
    assert (labrig(*cut).exit_code, labrig(*cut, "--force").exit_code) == (2, 0)
    calibration = sweep.run / "calibration"
    mapping = (
        "--intrinsics",
        calibration / "intrinsics.json",
        "--plane",
        calibration / "plane.json",
        "--json",
    )
    asked = ("--template", template, *mapping)
    found = labrig("measure", "tip", *finals, *asked)
    assert found.exit_code == 0, [row["reason"] for row in found.json()]
    by_shaft = labrig("measure", "curvature", *finals, *mapping, "--sheath-diameter-mm", 2).json()
    for row, other in zip(found.json(), by_shaft, strict=True):
        assert row["accepted"]
        assert math.dist(row["tip_mm"], other["tip_mm"]) < 0.4
    tip = found.json()[0]
    given = (
        "measure",
        "tip",
        finals[0],
        *asked,
        "--heading-deg",
        math.degrees(tip["heading_rad"]),
        "--near-px",
    )
    near = labrig(*given, tip["tip_px"][0] + 6, tip["tip_px"][1] - 5)
    assert near.json()[0]["tip_px"] == pytest.approx(tip["tip_px"], abs=0.2)
    far = labrig(*given, 40, 200)
    assert (far.exit_code, far.json()[0]["tip_px"], bool(far.json()[0]["reason"])) == (1, None, True)


def test_a_picture_and_both_ends_by_hand_need_no_map(
    labrig: Labrig, finals: list[Path], tmp_path: Path
) -> None:
    """If tip and heading are given the shaft is not measured, and no plane map is needed."""
    out = tmp_path / "by-hand.png"
    asked = ("calibrate", "template", finals[0], "--tip-px", 150, 110, "--out", out)
    assert labrig(*asked).exit_code == 2
    assert labrig(*asked, "--heading-deg", -30).exit_code == 0
    assert json.loads(out.with_suffix(".json").read_text())["heading_rad"] == pytest.approx(math.radians(-30))
