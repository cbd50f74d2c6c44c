"""Masks on the command line: which commands accept them, and how the record keeps them."""

import json
import shutil
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.cli.conftest import RIG, SWEEP, Labrig, SweepRun

TEMPLATE = RIG.parent / "simulated-tip.png"
ONE_INSERTION = (
    "--set", "insertions_per_specimen=1", "--set", "specimens=[{name: gel-10, gelatin_percent: 10}]",
)  # fmt: skip
BELOW = [[0, 400], [1279, 640], [1279, 719], [0, 719]]


@pytest.fixture(scope="module")
def good(sweep: SweepRun) -> Path:
    """Return a picture of an inserted needle."""
    lines = [json.loads(line) for line in (sweep.run / "frames.jsonl").read_text().splitlines()]
    return sweep.run / next(line["file"] for line in lines if line["role"] == "final")


@pytest.fixture
def two_needles(good: Path, tmp_path: Path) -> Path:
    """Return a folder with a picture of two needles, and one of one needle."""
    folder = tmp_path / "pictures"
    folder.mkdir()
    picture = cv2.imread(str(good), cv2.IMREAD_GRAYSCALE)
    cv2.imwrite(str(folder / "one.png"), picture)
    cv2.imwrite(str(folder / "two.png"), np.minimum(picture, np.roll(picture, 180, axis=0)))
    return folder


def polygon(path: Path, name: str, corners: Sequence[Sequence[float]]) -> Path:
    """Return the path of a mask with one polygon for one picture, or for all."""
    path.write_text(json.dumps({name: [corners]}))
    return path


def mapping(sweep: SweepRun) -> tuple[object, ...]:
    """Return the options that turn pixels of the sweep's pictures into mm."""
    calibration = sweep.run / "calibration"
    return ("--intrinsics", calibration / "intrinsics.json", "--plane", calibration / "plane.json")


def test_imported_pictures_keep_their_mask(
    labrig: Labrig, sweep: SweepRun, two_needles: Path, tmp_path: Path
) -> None:
    """Polygons by the names that the pictures had go into the run and count in every analysis, unless one is given."""
    mask, other = (
        polygon(tmp_path / "not-needle.json", "two.png", BELOW),
        polygon(tmp_path / "b.json", "no.png", BELOW),
    )
    options = ("--sheath-diameter-mm", 2, "--runs-dir", tmp_path / "runs", *mapping(sweep))
    run = Path(labrig("import", two_needles, *options, "--mask", mask, "--json").json()[0]["run"])
    assert (run / "calibration" / "mask.json").read_bytes() == mask.read_bytes()
    assert labrig("runs", "check", run).exit_code == 0
    for given, used, accepted in (((), mask, True), (("--mask", other), other, False)):
        analysis = Path(labrig("reanalyze", run, *given, "--json").json()[0]["analysis"])
        result = json.loads((analysis / "result.json").read_text())
        by_name = {measurement["image"]: measurement for measurement in result["measurements"]}
        assert by_name["one.png"]["accepted"]
        assert by_name["two.png"]["accepted"] == accepted, by_name["two.png"]["reason"]
        assert (analysis / "mask.json").read_bytes() == used.read_bytes()


def test_a_rig_has_a_mask_that_every_run_keeps_and_uses(labrig: Labrig, tmp_path: Path) -> None:
    """A mask of the rig file is checked, recorded, and applied to every picture."""
    folder = tmp_path / "calibration"
    shutil.copytree(RIG.parent, folder)
    rig = folder / RIG.name
    named = "  mask: clamp.png\n  template: simulated-tip.png"
    rig.write_text(rig.read_text().replace("  template: simulated-tip.png", named))
    runs = ("--rig", rig, "--runs-dir", tmp_path / "runs", *ONE_INSERTION, "--json")
    missing = labrig("run", SWEEP, *runs)
    assert missing.exit_code == 2
    assert "clamp.png does not exist" in missing.out
    cv2.imwrite(str(folder / "clamp.png"), np.full((720, 1280), 255, np.uint8))
    run = Path(labrig("run", SWEEP, *runs).json()["run"])
    assert (run / "calibration" / "mask.png").read_bytes() == (folder / "clamp.png").read_bytes()
    result = json.loads((run / "analysis" / "001" / "result.json").read_text())
    assert not any(measurement["accepted"] for measurement in result["measurements"]), "everything is masked"
    assert result["settings"]["mask"] == "mask.png"
    assert labrig("replay", run, "--json").json()["identical"]
