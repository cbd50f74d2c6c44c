"""From a run on disk to its result on disk."""

import csv
import hashlib
import json
import os
import select
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from labrig.analysis.result import load_centre_lines
from labrig.errors import DiskError, FileFormatError, InputError, RecordError
from labrig.experiments.registry import load_run_result
from labrig.experiments.shared.curvature_result import CurvatureResult
from labrig.record.reader import open_run
from labrig.record.results import finish_result
from tests.analysis.conftest import measure
from tests.analysis.synthetic import LENGTH_MM, SyntheticSweep, abort_sweep, record_sweep
from tests.disks import full_disk
from tests.record.runs import flip_bit


def _raw_bytes(run: Path) -> dict[str, str]:
    return {
        path.relative_to(run).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(run.rglob("*"))
        if path.is_file() and "analysis" not in path.parts and path.name != "chain.jsonl"
    }


def test_each_radius_is_that_of_the_drawn_arc(measured):
    """Final pictures give the drawn radii within 0.05 mm, by gel, with the interval of the mean.

    Drawn means count every drawn radius, and the worst error is that of an accepted picture.
    """
    first, second = measured.content.specimens
    assert (first.name, first.n, first.mean_radius_mm) == ("gel A", 2, pytest.approx(28.3, abs=0.05))
    assert first.ci95_mm[0] < 28.3 < first.ci95_mm[1]
    assert (second.n, second.mean_radius_mm, second.sd_radius_mm) == (1, pytest.approx(27.0, abs=0.05), None)
    assert measured.content.mean_radius_mm == pytest.approx((28.3 + 27.0) / 2, abs=0.05)
    assert [gel.true_mean_radius_mm for gel in (first, second)] == pytest.approx([28.3, 27.2])
    assert [gel.worst_error_mm for gel in (first, second)] == pytest.approx([0.0, 0.0], abs=0.05)


def test_every_picture_of_the_needle_is_measured_and_no_other(measured):
    """Pictures on the way enter no mean, the sheath alone is not measured, and one without a needle is refused."""
    content = measured.content
    found = [(one.role, one.accepted) for one in content.measurements]
    assert found == [("advance", False), ("advance", True), ("final", True)] * 3 + [
        ("advance", False), ("advance", False), ("final", False),
    ]  # fmt: skip
    last = content.measurements[-1]
    assert (last.trial, last.found, bool(last.reason), last.radius_mm) == (3, False, True, None)
    assert [(specimen.n, specimen.refused) for specimen in content.specimens] == [(2, 0), (1, 1)]
    assert content.specimens[1].refused_reasons[0].startswith("1 x ")
    assert content.damage == ()


def test_a_result_that_cannot_be_written_leaves_no_folder(tmp_path):
    """On a full disk the analysis fails, its folder is removed, and the next result takes its number."""
    run = record_sweep(tmp_path, SyntheticSweep(radii_mm={"gel": (28.0,)}, gelatin_percent=(10.0,)))
    for longest_bytes in (0, 5_000):
        with full_disk(longest_bytes), pytest.raises(DiskError, match=r"analysis/001/.*File too large"):
            measure(run)
        assert list((run.path / "analysis").iterdir()) == []
    assert measure(run).result.path.name == "001"


def test_damage_is_named_and_the_batch_goes_on(tmp_path):
    """A picture with a flipped bit, one that is missing, one that was exchanged, and states cut at their end."""
    run = record_sweep(tmp_path)
    names = list(run.frame_table.loc[run.frame_table["role"] == "final", "file"])[:3]
    flipped, missing, exchanged = (run.path / name for name in names)
    flip_bit(flipped)
    missing.unlink()
    cv2.imwrite(str(exchanged), np.zeros((380, 480), np.uint8))
    states = run.path / "states.jsonl"
    states.write_bytes(states.read_bytes()[:-10])
    found = measure(open_run(run.path)).content
    finals = [one for one in found.measurements if one.role == "final"]
    assert [one.accepted for one in finals] == [False, False, False, True]
    assert finals[0].reason == f"{flipped.name} is damaged: its SHA-256 does not fit frames.jsonl"
    assert all(Path(name).name in one.reason for name, one in zip(names, finals, strict=False))
    assert all(str(run.path) not in (one.reason or "") for one in found.measurements)
    assert {told.partition(": ")[0] for told in found.damage} == {*names, "states.jsonl"}
    assert found.mean_radius_mm is not None


def test_the_result_is_the_same_for_any_number_of_workers(measured):
    """Parallel work changes neither a digit nor the order, and progress is told after each picture."""
    updates: list[tuple[int, int]] = []
    parallel = measure(measured.run, workers=3, progress=lambda done, total: updates.append((done, total)))
    assert updates == [(number, 12) for number in range(1, 13)]
    assert parallel.content.measurements == measured.content.measurements
    assert parallel.content.specimens == measured.content.specimens
    for name in ("measurements.csv", "specimens.csv"):
        assert (parallel.result.path / name).read_bytes() == (measured.result.path / name).read_bytes()


def test_workers_end_with_a_parent_that_was_killed(measured):
    """After SIGKILL to the measuring process none of its workers is left waiting."""
    script = """
import os, signal, sys
from labrig.analysis.run import analyze_run
from labrig.experiments.registry import find_run_experiment
from labrig.record.reader import open_run
from labrig.record.results import finish_result
from tests.analysis.synthetic import NOW

def die(done, total):
    print(open(f"/proc/self/task/{os.getpid()}/children").read(), flush=True)
    os.kill(os.getpid(), signal.SIGSTOP)

run = open_run(sys.argv[1])
analyze_run(run, find_run_experiment(run), workers=2, progress=die, created=NOW, provenance={})
"""
    root = Path(__file__).parents[2]
    command = [sys.executable, "-c", script, str(measured.run.path)]
    with subprocess.Popen(command, cwd=root, stdout=subprocess.PIPE, text=True) as parent:
        workers = [os.pidfd_open(int(pid)) for pid in parent.stdout.readline().split()]
        parent.kill()
    assert len(workers) == 2
    for worker in workers:
        assert select.select([worker], [], [], 30.0)[0] == [worker]
        os.close(worker)


def test_a_new_result_stands_beside_the_old_and_the_record_is_untouched(tmp_path):
    """Reanalysis numbers its result on, names its parent, and rewrites no raw byte; a copy beside them is no result."""
    run = record_sweep(tmp_path)
    before = _raw_bytes(run.path)
    assert load_run_result(run) is None
    with pytest.raises(InputError, match="no result 004"):
        load_run_result(run, 4)
    first, second = measure(run).result, measure(run, "analysis.window_start_mm=6").result
    assert [path.name for path in (first.path, second.path)] == ["001", "002"]
    assert (first.content.parent, second.content.parent) == (None, 1)
    assert second.content.settings.window_start_mm == 6.0
    assert second.content.overrides == ("analysis.window_start_mm=6",)
    assert _raw_bytes(run.path) == before
    shutil.copytree(second.path, second.path.with_name("002.bak"))
    assert run.result_numbers == (1, 2)
    assert (load_run_result(run, 1), load_run_result(run)) == (first, second)


def test_a_damaged_result_is_refused_with_its_path(tmp_path):
    """A result that was changed is not read, nor one that comes from a newer labrig."""
    run = record_sweep(tmp_path, SyntheticSweep(radii_mm={"gel": (28.0,)}, gelatin_percent=(10.0,)))
    result = measure(run).result
    file = result.path / "result.json"
    content = file.read_bytes()
    file.write_bytes(content.replace(b"28.", b"99."))
    with pytest.raises(RecordError, match=r"001/result\.json: it does not fit"):
        load_run_result(run)
    file.write_text(json.dumps({**json.loads(content), "schema_version": 2}))
    (result.path / "SHA256SUMS").unlink()
    finish_result(result.path)
    with pytest.raises(RecordError, match=r"result\.json.*schema_version"):
        load_run_result(run)


def test_damaged_centre_lines_are_refused_with_their_path(measured, tmp_path):
    """No archive, or one without some of its arrays."""
    file = tmp_path / "centre_lines.npz"
    with np.load(measured.result.path / file.name) as arrays:
        np.savez_compressed(file, allow_pickle=False, frames=arrays["frames"])
    for content in (file.read_bytes(), b"PK"):
        file.write_bytes(content)
        with pytest.raises(RecordError, match=r"centre_lines\.npz cannot be read"):
            load_centre_lines(tmp_path)


@pytest.mark.parametrize(
    ("record", "override", "words"),
    [
        ("steerability", "needle.diameter_mm=2", "needle"),
        ("steerability", "analysis.window_begin_mm=2", "window_begin_mm"),
        *(("insertion", each, r"only estimator\.\*, planner\.radius_mm")
          for each in ("planner.method=paper", "policy.near_mm=0", "estimator=1", "planner.radius_mm_=30")),
    ],
)  # fmt: skip
def test_only_what_a_measurement_reads_can_be_overridden(record, override, words):
    """What the rig did cannot be changed afterwards; another planner would have steered another way."""
    with pytest.raises((InputError, FileFormatError), match=words):
        measure(open_run(Path(__file__).parents[1] / "records" / record), override)


def test_an_analysis_that_cannot_begin_leaves_nothing(tmp_path):
    """Without a plane map there is no scale, and no empty result is left behind."""
    run = record_sweep(tmp_path, SyntheticSweep(plane=False))
    with pytest.raises(InputError, match=r"plane\.json"):
        measure(run)
    assert not (run.path / "analysis").exists()


def test_tables_name_units_and_hold_every_picture(measured):
    """tables.json lists each CSV file, its columns with their units, and its rows; pairs and budgets are split.

    A cell that would begin a formula is marked as text.
    """
    folder = measured.result.path
    listed = json.loads((folder / "tables.json").read_text(encoding="utf-8"))
    assert listed.keys() == {"measurements", "specimens", "origins"}
    for table in listed.values():
        read = list(csv.reader((folder / table["file"]).read_text(encoding="utf-8").splitlines()))
        assert [column["name"] for column in table["columns"]] == read[0]
        assert table["rows"] == len(read) - 1
    units = {column["name"]: column["unit"] for column in listed["measurements"]["columns"]}
    some = ("radius_mm", "tip_u_px", "gelatin_percent", "frame")
    assert [units[name] for name in some] == ["mm", "px", "percent", None]
    lengths = [name for name in units if any(word in name for word in ("radius", "tip", "arc", "residual"))]
    assert all(name.endswith(("_mm", "_px")) for name in lengths)
    final: Any = measured.content.measurements[2]
    known = {
        "radius_mm": final.radius_mm, "radius_ci95_low_mm": final.radius_ci95_mm[0],
        "radius_ci95_high_mm": final.radius_ci95_mm[1], "sigma_radius_fit_mm": final.radius_budget_mm.fit,
        "sigma_radius_lighting_mm": final.radius_budget_mm.lighting,
    }  # fmt: skip
    rows = list(csv.DictReader((folder / "measurements.csv").read_text(encoding="utf-8").splitlines()))
    assert {name: float(rows[2][name]) for name in known} == known
    # Without intrinsics it is not known where the camera stands, nor what a roll before it does.
    assert rows[2]["sigma_radius_roll_mm"] == rows[2]["sigma_radius_surface_mm"] == ""
    assert rows[-1]["radius_mm"] == rows[-1]["sigma_radius_fit_mm"] == ""
    assert "'=gel B" in (folder / "specimens.csv").read_text(encoding="utf-8")


def test_centre_lines_lead_from_the_sheath_to_the_tip(measured):
    """The stored lines are those of the pictures, in mm and in pixels, with the window that was fitted."""
    lines = load_centre_lines(measured.result.path)
    frame = measured.content.measurements[2].frame
    mm, px, (first, end) = lines[frame].mm, lines[frame].px, lines[frame].window
    assert mm.shape == px.shape
    assert 0 < first < end < len(mm)
    assert np.hypot(*np.diff(mm, axis=0).T).sum() == pytest.approx(LENGTH_MM, abs=1.5)
    assert np.hypot(mm[first:end, 0] + 28.0, mm[first:end, 1]) == pytest.approx(28.0, abs=0.1)


def test_the_result_names_what_it_rests_on(measured):
    """Hashes of the inputs, code version, time and settings are in the result itself."""
    content = measured.content
    frames = (measured.run.path / "frames.jsonl").read_bytes()
    assert content.inputs["frames.jsonl"] == hashlib.sha256(frames).hexdigest()
    assert {"protocol.yaml", "calibration/plane.json", "truth.jsonl"} <= content.inputs.keys()
    assert content.provenance["labrig"] == "0.1.0"
    assert content.created == "2026-11-21T09:30:00+00:00"
    assert content.settings.needle_diameter_mm == 1.2


@pytest.mark.parametrize(
    "sweep",
    [abort_sweep(SyntheticSweep()), SyntheticSweep(exit_status=None, without_final=frozenset({2, 3}))],
)
def test_a_run_that_did_not_end_is_measured_as_far_as_it_goes(tmp_path, sweep):
    """Aborted and killed runs give the insertions that they have, and say which left no final picture.

    The torn last line of a killed process does not count as damage.
    """
    run = record_sweep(tmp_path, sweep)
    if sweep.exit_status is None:
        with (run.path / "states.jsonl").open("ab") as file:
            file.write(b'{"t_s":')
    content = measure(open_run(run.path)).content
    assert content.damage == ()
    assert sum(specimen.n for specimen in content.specimens) == 4 - len(sweep.without_final)
    assert sum(specimen.without_final_picture for specimen in content.specimens) == len(sweep.without_final)


def test_a_run_without_pictures_has_an_empty_result(tmp_path):
    """A run that stopped before its first picture has an empty result."""
    sweep = SyntheticSweep(radii_mm={"gel A": ()}, gelatin_percent=(10.0,), exit_status="aborted")
    result = measure(open_run(record_sweep(tmp_path, sweep).path), workers=2).result
    assert isinstance(result.content, CurvatureResult)
    assert result.content.measurements == ()
    assert load_centre_lines(result.path) == {}
