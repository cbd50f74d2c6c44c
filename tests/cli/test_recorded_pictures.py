"""A rig with recorded pictures in place of its camera, from the rig file to the page."""

import json
import shutil
from pathlib import Path
from typing import Any

import pytest

from labrig.record.json_lines import decode_line
from labrig.record.reader import open_run
from tests.cli.conftest import ROOT, Labrig

RECORD = ROOT / "tests" / "records" / "steerability"
CAMERA = "camera: {driver: files, source: pictures, width_px: 352, height_px: 224, rate_hz: 30}\n"
CALIBRATION = "calibration: {intrinsics: calibration/intrinsics.json, plane: calibration/plane.json}\n"


def _rig(folder: Path) -> Path:
    """Write the rig of a kept record, with the pictures of that record in place of its camera."""
    shutil.copytree(RECORD / "frames", folder / "pictures", dirs_exist_ok=True)
    shutil.copytree(RECORD / "calibration", folder / "calibration", dirs_exist_ok=True)
    text = (RECORD / "rig.yaml").read_text(encoding="utf-8")
    before, rest = text.split("camera:\n", 1)
    after = rest.split("recording:\n", 1)[1]
    path = folder / "rig.yaml"
    path.write_text(f"{before}{CAMERA}{CALIBRATION}recording:\n{after}", encoding="utf-8")
    return path


def _frames(run: Path) -> list[dict[str, Any]]:
    return [decode_line(line) for line in (run / "frames.jsonl").read_bytes().splitlines()]


@pytest.mark.processors
def test_a_sweep_runs_whole_on_the_pictures_of_another(labrig: Labrig, tmp_path: Path) -> None:
    """Its radii are theirs to 1 % of sigma; the page says `recorded pictures`, no truth is recorded; it replays."""
    runs_dir = ("--runs-dir", tmp_path / "runs", "--json")
    done = labrig("run", RECORD / "protocol.yaml", "--rig", _rig(tmp_path), *runs_dir)
    assert done.exit_code == 0, done.err
    run = Path(done.json()["run"])
    before = json.loads((RECORD / "analysis" / "001" / "result.json").read_text(encoding="utf-8"))
    after = json.loads((run / "analysis" / "001" / "result.json").read_text(encoding="utf-8"))
    sigma_mm = before["measurements"][-1]["sigma_radius_mm"]
    assert after["mean_radius_mm"] == pytest.approx(before["mean_radius_mm"], abs=0.01 * sigma_mm)
    assert [line["sha256"] for line in _frames(run)] == [line["sha256"] for line in _frames(RECORD)]
    camera = open_run(run).devices["camera"]
    assert (camera["driver"], camera["device"], camera["recorded_pictures"]) == ("files", "pictures", True)
    assert "recorded pictures</span>" in (run / "report.html").read_text(encoding="utf-8")
    assert after.get("truth") is None
    assert labrig("runs", "check", run).exit_code == 0
    assert labrig("replay", run, "--json").json()["verdict"] == "identical"


def test_pictures_that_end_too_soon_end_the_run(labrig: Labrig, tmp_path: Path) -> None:
    """If the pictures run out the run exits with 3 and states their number, and how to find the number needed."""
    rig = _rig(tmp_path)
    (tmp_path / "pictures" / "000007.png").unlink()
    done = labrig("run", RECORD / "protocol.yaml", "--rig", rig, "--runs-dir", tmp_path / "runs", "--json")
    assert done.exit_code == 3
    assert "the 7 pictures of folder" in done.out
    assert (
        json.loads(next((tmp_path / "runs").glob("*/manifest.json")).read_text())["exit_status"] == "failed"
    )


def test_real_drives_are_not_steered_by_recorded_pictures(labrig: Labrig, tmp_path: Path) -> None:
    """An insertion and a roll zero are refused before anything is opened; a sweep with fixed moves is accepted."""
    text = (ROOT / "calibration" / "rig-bench.yaml").read_text(encoding="utf-8")
    before, rest = text.split("camera:\n", 1)
    after = rest.split("\n\n", 1)[1]
    rig = tmp_path / "rig.yaml"
    rig.write_text(
        f"{before}camera: {{driver: files, source: p, width_px: 64, height_px: 48, rate_hz: 30}}\n\n{after}",
        encoding="utf-8",
    )

    def _collect_output(protocol: str) -> str:
        done = labrig("check", ROOT / "protocols" / protocol, "--rig", rig, "--json")
        return " ".join(problem["message"] for problem in done.json()["problems"])

    words = "moves real drives by what its pictures show, and camera.driver files gives recorded pictures"
    assert f"insertion {words}" in _collect_output("insertion.yaml")
    assert f"roll-zero {words}" in _collect_output("roll-zero.yaml")
    assert words not in _collect_output("steerability.yaml")
    assert labrig("run", ROOT / "protocols" / "insertion.yaml", "--rig", rig).exit_code == 2


def test_devices_check_says_that_pictures_are_recorded(labrig: Labrig, tmp_path: Path) -> None:
    """`labrig devices check` states that the pictures are recorded and never steer."""
    done = labrig("devices", "check", "--rig", _rig(tmp_path))
    assert "352x224 px, recorded pictures of pictures: they never steer" in done.out
