"""A camera as it was calibrated: a run refuses another focus, and uses its mask."""

import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.cli.conftest import RIG, SHORT_SWEEP, SMALL_SWEEP, SWEEP, Labrig


@pytest.mark.parametrize("set_focus", [(), ("--set", "rig.camera.focus=7")])
def test_a_run_refuses_a_focus_that_has_changed(
    set_focus: tuple[str, ...], labrig: Labrig, tmp_path: Path
) -> None:
    """Whether the rig file sets the focus or the camera reports it; nothing is recorded, and the exit code is 2."""
    folder = Path(shutil.copytree(RIG.parent, tmp_path / "calibration"))
    plane = folder / "simulated-plane.json"
    document = json.loads(plane.read_text())
    document["provenance"]["camera"] = {"settings": {"focus": 12}}
    plane.write_text(json.dumps(document))
    runs = tmp_path / "runs"
    done = labrig("run", SWEEP, "--rig", folder / RIG.name, "--runs-dir", runs, *SHORT_SWEEP, *set_focus)
    assert done.exit_code == 2
    focus = 7 if set_focus else 0
    assert f"simulated-plane.json was made with camera.focus 12, it is {focus} now" in done.err
    assert "hint: write camera.focus: 12 in the rig file, or calibrate again" in done.err
    assert not runs.exists() or not list(runs.glob("*/manifest.json"))


def test_a_rig_has_a_mask_that_every_run_keeps_and_uses(labrig: Labrig, tmp_path: Path) -> None:
    """A mask of the rig file is checked, recorded, and applied to every picture."""
    folder = tmp_path / "calibration"
    shutil.copytree(RIG.parent, folder)
    rig = folder / RIG.name
    named = "  mask: clamp.png\n  template: simulated-tip.png"
    rig.write_text(rig.read_text().replace("  template: simulated-tip.png", named))
    one = ("--set", "insertions_per_specimen=1", "--rig", rig, "--runs-dir", tmp_path / "runs", "--json")
    runs = (*SMALL_SWEEP, *one)
    missing = labrig("run", SWEEP, *runs)
    assert missing.exit_code == 2
    assert "clamp.png does not exist" in missing.out
    cv2.imwrite(str(folder / "clamp.png"), np.full((224, 352), 255, np.uint8))
    run = Path(labrig("run", SWEEP, *runs).json()["run"])
    assert (run / "calibration" / "mask.png").read_bytes() == (folder / "clamp.png").read_bytes()
    result = json.loads((run / "analysis" / "001" / "result.json").read_text())
    assert not any(measurement["accepted"] for measurement in result["measurements"]), "everything is masked"
    assert "calibration/mask.png" in result["inputs"]
    assert labrig("replay", run, "--json").json()["identical"]
