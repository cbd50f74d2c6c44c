r"""A record of each experiment, made once and kept under tests/records.

They were made by what follows, from the top of a checkout, and their manifests say by which commit and on which
processor. Another processor measures and replays them within the tolerances of `labrig.record.agreement`.

KEPT=tests/records
NEAR=(--rig calibration/rig-simulated.yaml --runs-dir $KEPT --set rig.world.noise_sd=0
  --set rig.recording.state_rate_hz=2
  --set rig.can.heartbeat.period_ms=250 --set rig.can.heartbeat.timeout_ms=1250
  --set rig.camera.width_px=352 --set rig.camera.height_px=224 --set "rig.world.lens={width_px: 352, height_px: 224,
  fx_px: 493, fy_px: 494, cx_px: 178, cy_px: 110, distance_mm: 63, origin_px: [123, 112]}")
FOUND=camera-calibration/analysis/001
QUICK=("${NEAR[@]}" --set rig.calibration.intrinsics=../$KEPT/$FOUND/intrinsics.json
  --set rig.calibration.plane=../$KEPT/$FOUND/plane.json
  --set sheath.speed_mm_s=15 --set insertion.speed_mm_s=5 --set insertion.withdraw_speed_mm_s=15)
ROLLS=(--set roll_zero.rolls=4 --set roll_zero.length_mm=12)
labrig run protocols/calibration.yaml --run-name camera-calibration "${NEAR[@]}" --set rig.calibration.plane=null \
  --set rig.calibration.intrinsics=null --set views=6 --set plane.origin_px=[123,112]
labrig run protocols/steerability.yaml --run-name steerability "${QUICK[@]}" --set insertions_per_specimen=2 \
  --set "specimens=[{name: gel, gelatin_percent: 13}]" --set insertion.length_mm=22 --set insertion.frame_every_mm=20
labrig run protocols/roll-zero.yaml --run-name roll-zero "${QUICK[@]}" "${ROLLS[@]}" --set roll_zero.torsion=null
labrig run protocols/insertion.yaml --run-name insertion "${QUICK[@]}" "${ROLLS[@]}" --set target.position_mm=[0,2,20] \
  --set "obstacles=[{position_mm: [0, 9, 12], radius_mm: 3}]" --set insertion.max_length_mm=30 \
  --set insertion.frame_every_mm=3 --set policy.near_mm=0 --set policy.final_mm=0
labrig run protocols/design.yaml --run-name design --runs-dir $KEPT --set grid_points=3
mkdir import && cp $KEPT/steerability/frames/00000[37].png import
labrig import import --intrinsics $KEPT/$FOUND/intrinsics.json --plane $KEPT/$FOUND/plane.json \
  --needle-diameter-mm 1.2 --sheath-diameter-mm 2 --runs-dir $KEPT --json
mv $KEPT/*-import $KEPT/import && labrig reanalyze $KEPT/import
rm -r import $KEPT/*/report.html

They are made anew whenever the format of records or what a procedure asks changes.
"""

import json
import shutil
from pathlib import Path

import pytest

from labrig.record.json_lines import decode_line, encode_line
from tests.cli.conftest import ROOT, Labrig
from tests.cli.cut_runs import open_again

KEPT = ROOT / "tests" / "records"
NAMES = sorted(path.name for path in KEPT.iterdir())
AGREES = ("identical", "equivalent")


@pytest.fixture(params=NAMES)
def kept(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """Return a writable copy of a kept record."""
    return Path(shutil.copytree(KEPT / request.param, tmp_path / request.param))


def test_one_of_each_experiment_is_kept() -> None:
    """Every experiment has a kept record."""
    experiments = {
        json.loads((KEPT / name / "manifest.json").read_text(encoding="utf-8"))["experiment"]
        for name in NAMES
    }
    assert experiments >= {
        "steerability", "insertion", "roll-zero", "camera-calibration", "design", "import",
    }  # fmt: skip


def test_together_they_are_small() -> None:
    """The kept records are small enough for a checkout."""
    assert sum(path.stat().st_size for path in KEPT.rglob("*") if path.is_file()) < 2_200_000


def test_a_kept_record_is_sound(kept: Path, labrig: Labrig) -> None:
    """Every file of a kept record passes its checksums."""
    (row,) = labrig("runs", "check", kept, "--json").json()
    assert (row["ok"], row["damage"], row["torn"], row["exit_status"]) == (True, [], [], "success")


@pytest.mark.processors
def test_a_kept_record_is_measured_as_before(kept: Path, labrig: Labrig) -> None:
    """A reanalysis gives every number of the kept result, on any processor within its tolerance."""
    done = labrig("reanalyze", kept, "--json")
    (row,) = done.json()
    assert (done.exit_code, row["ok"], Path(row["analysis"]).name) == (0, True, "002")
    assert row["verdict"] in AGREES, row["first_difference"]


@pytest.mark.processors
def test_a_kept_record_replays(kept: Path, labrig: Labrig) -> None:
    """The procedure decides the same again; no procedure made imported pictures."""
    done = labrig("replay", kept, "--json")
    if kept.name == "import":
        assert done.exit_code == 2
    else:
        replay = done.json()
        assert (done.exit_code, replay["first_difference"]) == (0, None)
        assert replay["verdict"] in AGREES


@pytest.mark.processors
@pytest.mark.parametrize("name", ["insertion", "roll-zero", "steerability", "camera-calibration"])
def test_a_decision_that_was_altered_by_hand_is_different(tmp_path: Path, labrig: Labrig, name: str) -> None:
    """Whatever the processor: one word of one question is not what the procedure says."""
    run = Path(shutil.copytree(KEPT / name, tmp_path / name))
    events = run / "events.jsonl"
    lines = [decode_line(line) for line in events.read_bytes().splitlines()]
    number = next(n for n, line in enumerate(lines) if line["kind"] == "operator" and line["details"])
    details = dict(lines[number]["details"])  # type: ignore[call-overload]
    key = next(iter(details))
    lines[number] |= {"details": details | {key: f"{details[key]} other"}}
    events.write_bytes(b"".join(map(encode_line, lines)))
    (run / "SHA256SUMS").unlink()
    open_again(run)
    done = labrig("replay", run, "--json")
    replay = done.json()
    assert (done.exit_code, replay["verdict"]) == (1, "different")
    assert replay["first_difference"]["path"] == f"operator.details.{key}"


def test_a_kept_record_is_reported(kept: Path, labrig: Labrig) -> None:
    """The page can be made from the record and its kept result."""
    (row,) = labrig("report", kept, "--json").json()
    assert (row["ok"], row["reason"]) == (True, None)
    assert "<html" in Path(row["report"]).read_text(encoding="utf-8")
