"""`labrig calibrate template` and `labrig measure tip`."""

import json
import math
from pathlib import Path

import pytest

from tests.cli.conftest import RIG, Labrig, SweepRun

CALIBRATION = RIG.parent
MAPPING = (
    "--intrinsics",
    CALIBRATION / "simulated-intrinsics.json",
    "--plane",
    CALIBRATION / "simulated-plane.json",
)
SCALE = ("--px-per-mm", 10, "--origin-px", 0, 0, "--insertion", "right")
TEMPLATE = CALIBRATION / "simulated-tip.png"


def _finals(sweep: SweepRun) -> list[Path]:
    lines = [json.loads(line) for line in (sweep.run / "frames.jsonl").read_text().splitlines()]
    return [sweep.run / line["file"] for line in lines if line["role"] == "final"]


def test_a_template_of_one_frame_finds_the_tips_of_others(
    labrig: Labrig, sweep: SweepRun, tmp_path: Path
) -> None:
    """A template cut from one insertion finds the final tips of all insertions where their shafts end."""
    template = tmp_path / "tip.png"
    made = labrig("calibrate", "template", sweep.run, "--frame", 5, "--out", template, "--json")
    assert made.exit_code == 0
    assert abs(made.json()["heading_deg"]) < 90
    finals = _finals(sweep)
    found = labrig("measure", "tip", *finals, "--template", template, *MAPPING, "--json")
    assert found.exit_code == 0, [row["reason"] for row in found.json()]
    by_shaft = labrig("measure", "curvature", *finals, *MAPPING, "--sheath-diameter-mm", 2, "--json").json()
    for row, other in zip(found.json(), by_shaft, strict=True):
        assert row["accepted"]
        assert math.dist(row["tip_mm"], other["tip_mm"]) < 0.4


def test_heading_and_place_that_are_given_narrow_the_search(labrig: Labrig, sweep: SweepRun) -> None:
    """The tip is found near a given place, and not elsewhere, which exits with 1."""
    picture = _finals(sweep)[0]
    asked = ("measure", "tip", picture, "--template", TEMPLATE, *MAPPING, "--json")
    tip = labrig(*asked).json()[0]
    given = ("--heading-deg", math.degrees(tip["heading_rad"]), "--near-px")
    near = labrig(*asked, *given, tip["tip_px"][0] + 12, tip["tip_px"][1] - 9)
    assert near.json()[0]["tip_px"] == pytest.approx(tip["tip_px"], abs=0.2)
    far = labrig(*asked, *given, 300, 60)
    assert far.exit_code == 1
    assert far.json()[0]["tip_px"] is None
    assert far.json()[0]["reason"]


def test_a_picture_and_both_ends_by_hand_need_no_map(labrig: Labrig, sweep: SweepRun, tmp_path: Path) -> None:
    """If tip and heading are given the shaft is not measured, and no plane map is needed."""
    out = tmp_path / "by-hand.png"
    picture = _finals(sweep)[0]
    asked = ("calibrate", "template", picture, "--tip-px", 300, 350, "--out", out)
    assert labrig(*asked).exit_code == 2
    assert labrig(*asked, "--heading-deg", -30).exit_code == 0
    assert json.loads(out.with_suffix(".json").read_text())["heading_rad"] == pytest.approx(math.radians(-30))


def test_a_template_is_not_replaced_without_force(labrig: Labrig, sweep: SweepRun, tmp_path: Path) -> None:
    """An existing file is refused, whether it is the picture or the JSON."""
    out = tmp_path / "tip.png"
    (tmp_path / "tip.json").write_text("{}")
    asked = ("calibrate", "template", sweep.run, "--frame", 5, "--out", out)
    refused = labrig(*asked, "--json")
    assert refused.exit_code == 2
    assert refused.json()["error"]["type"] == "OutputExistsError"
    assert labrig(*asked, "--force").exit_code == 0


@pytest.mark.parametrize(
    "arguments", [("--frame", 9999), ("--tip-px", 2, 2, "--heading-deg", 0), ("--tip-px", "nan", 5)]
)
def test_what_cannot_be_cut_out_is_refused(
    labrig: Labrig, sweep: SweepRun, tmp_path: Path, arguments: tuple[object, ...]
) -> None:
    """A missing frame and a tip at the border or absent are named, and no file is written."""
    out = tmp_path / "tip.png"
    done = labrig("calibrate", "template", sweep.run, "--out", out, *arguments)
    assert done.exit_code in {2, 4}
    assert "Traceback" not in done.err
    assert not list(tmp_path.iterdir())


def test_a_template_that_cannot_be_used_is_wrong_input(
    labrig: Labrig, sweep: SweepRun, tmp_path: Path
) -> None:
    """A template without its JSON, or with JSON of another kind, exits with 2."""
    picture = _finals(sweep)[0]
    (tmp_path / "tip.png").write_bytes(TEMPLATE.read_bytes())
    asked = ("measure", "tip", picture, "--template", tmp_path / "tip.png", *SCALE)
    assert labrig(*asked).exit_code == 2
    (tmp_path / "tip.json").write_text('{"kind": "labrig-plane"}')
    done = labrig(*asked)
    assert done.exit_code == 2
    assert "tip.json" in done.err
