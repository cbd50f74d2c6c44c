"""The mask of a rig: pixels that are not the needle."""

import json
import shutil
from pathlib import Path

import cv2
import numpy as np

from tests.cli.conftest import RIG, SWEEP, Labrig

ONE_INSERTION = (
    "--set", "insertions_per_specimen=1", "--set", "specimens=[{name: gel-10, gelatin_percent: 10}]",
)  # fmt: skip


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
    assert "calibration/mask.png" in result["inputs"]
    assert labrig("replay", run, "--json").json()["identical"]
