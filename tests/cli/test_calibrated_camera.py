"""A run whose camera is set otherwise than when it was calibrated."""

import json
import shutil
from pathlib import Path

import pytest

from tests.cli.conftest import RIG, SHORT_SWEEP, SWEEP, Labrig


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
