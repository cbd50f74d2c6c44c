r"""A record of each experiment, made once and kept under tests/records: later labrigs go on reading them.

They were made by what follows, from the top of a checkout, and their manifests say by which commit. Whoever makes one
anew loses what it holds of the past: add another beside it instead.

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

Where a later labrig measures better, its result stands beside the first one: analysis/002 of camera-calibration is the
first with the warp of the board, by `labrig reanalyze $KEPT/camera-calibration`, 004 and 005 the first by finders of
graph paper that round otherwise, 005 also the first with a bend of 0.02 mm, which was told as 697 mm. Those of import,
insertion and steerability are the first with error budgets, and 003 of these the first whose radii and tips are as
uncertain as the picture shows.
"""

import json
import shutil
from collections.abc import Mapping
from pathlib import Path

import pytest

from tests.cli.conftest import ROOT, Labrig

KEPT = ROOT / "tests" / "records"
NAMES = sorted(path.name for path in KEPT.iterdir())
OF_THE_MEASUREMENT = frozenset({"created", "inputs", "parent", "provenance"})


@pytest.fixture(params=NAMES)
def kept(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """Return a writable copy of a kept record."""
    return Path(shutil.copytree(KEPT / request.param, tmp_path / request.param))


def require_same(key: str, old: object, new: object) -> None:
    """Compare a value with what became of it; numbers to nine digits, since processors round otherwise.

    A newer result may say more than an older one, and not less.
    """
    if isinstance(old, Mapping) and isinstance(new, Mapping):
        for name, value in old.items():
            assert name in new, f"{key}.{name}"
            require_same(f"{key}.{name}", value, new[name])
    elif isinstance(old, list) and isinstance(new, list):
        assert len(old) == len(new), key
        for number, (before, now) in enumerate(zip(old, new, strict=True)):
            require_same(f"{key}.{number}", before, now)
    elif isinstance(old, float):
        assert new == pytest.approx(old, rel=1e-9, abs=1e-9), key
    else:
        assert new == old, key


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
    assert sum(path.stat().st_size for path in KEPT.rglob("*") if path.is_file()) < 2_000_000


def test_a_kept_record_is_sound(kept: Path, labrig: Labrig) -> None:
    """Every file of a kept record passes its checksums."""
    (row,) = labrig("runs", "check", kept, "--json").json()
    assert (row["ok"], row["damage"], row["torn"], row["exit_status"]) == (True, [], [], "success")


def test_a_kept_record_is_measured_as_before(kept: Path, labrig: Labrig) -> None:
    """A reanalysis gives every number of the last kept result."""
    done = labrig("reanalyze", kept, "--json")
    (row,) = done.json()
    *_, before, after = sorted((kept / "analysis").iterdir())
    assert (done.exit_code, row["ok"], Path(row["analysis"]).name) == (0, True, after.name)
    old, new = (
        json.loads((number / "result.json").read_text(encoding="utf-8")) for number in (before, after)
    )
    require_same("result", {key: old[key] for key in old.keys() - OF_THE_MEASUREMENT}, new)


def test_a_kept_record_replays_identically(kept: Path, labrig: Labrig) -> None:
    """The replay sends the recorded frames, to the last bit; imported pictures have none."""
    done = labrig("replay", kept, "--json")
    if kept.name == "import":
        assert done.exit_code == 2
    else:
        replay = done.json()
        assert (done.exit_code, replay["bit_exact"], replay["first_difference"]) == (0, True, None)


def test_a_kept_record_is_reported(kept: Path, labrig: Labrig) -> None:
    """The page can be made from the record and its kept result."""
    (row,) = labrig("report", kept, "--json").json()
    assert (row["ok"], row["reason"]) == (True, None)
    assert "<html" in Path(row["report"]).read_text(encoding="utf-8")
