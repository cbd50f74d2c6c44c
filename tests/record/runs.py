"""Runs to test with, whole and as faults leave them."""

import shutil
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from labrig.record.pictures import Store
from labrig.record.results import finish_result, new_result_dir
from labrig.record.writer import Recorder, opening_files

STARTED = datetime(2026, 3, 2, 9, 30, tzinfo=UTC)
ENDED = datetime(2026, 3, 2, 9, 45, tzinfo=UTC)

PROTOCOL_YAML = """\
experiment: import
seed: 7
needle: {needle_id: needle-a, diameter_mm: 1.2}
scale: {px_per_mm: 5.0, origin_px: [10, 20], insertion: right}
analysis: {window_start_mm: 4.0, window_end_mm: 2.0, min_window_mm: 15.0, max_radius_sigma_mm: 0.5}
"""
CAN_FRAMES = [(0.0, 0x601, bytes([0x40, 0x41, 0x60, 0, 0, 0, 0, 0]), "T"), (0.001, 0x581, bytes(8), "R")]


def begin(runs_dir: Path, name: str = "run", store: Store = "png", **manifest: object) -> Recorder:
    """Begin a run with two calibration files."""
    calibration = {"intrinsics.json": b'{"fx": 1.0}', "plane.json": b"{}"}
    known = {"experiment": "import", "title": "Größe", "started": STARTED.isoformat(), "trials_planned": 3}
    files = opening_files(PROTOCOL_YAML, "world: {}\n", calibration)
    return Recorder.create(runs_dir, name, {**known, "seed": 7, **manifest}, files, picture_store=store)


def picture(number: int, shape: tuple[int, ...] = (24, 32)) -> NDArray[np.uint8]:
    """Return a picture that no other number has."""
    return np.random.default_rng(number).integers(0, 256, shape, np.uint8)


def fill(recorder: Recorder, trials: int = 2) -> None:
    """Record trials of two pictures, three states and a truth each."""
    recorder.event("run_start", 0.0)
    for trial in range(trials):
        start_s = 10.0 * trial
        recorder.event("trial_start", start_s, trial=trial, specimen="gel 10", hole=trial)
        for step in range(3):
            axis = {"insertion_mm": np.float64(step) / 3, "insertion_statusword": np.int64(0x0237)}
            recorder.state(start_s + step, **axis)
        for step, role in enumerate(("advance", "final")):
            shown = {"trial": trial, "role": role, "insertion_mm": 1.0 + step}
            final = recorder.frame(picture(2 * trial + step), start_s + 3 + step, **shown)
        recorder.truth(trial=trial, radius_mm=27.5 + trial, tip_mm=np.array([1.0, 2.0]))
        recorder.event("trial_stop", start_s + 5, trial=trial, exit_status="success", final_frame=final)
    recorder.event("run_stop", 10.0 * trials)


def add_result(run: Path, content: bytes) -> Path:
    """Write a result, as an analysis does, and return its folder."""
    folder = new_result_dir(run)
    (folder / "result.json").write_bytes(content)
    finish_result(folder)
    return folder


def closed_run(runs_dir: Path, name: str = "run", store: Store = "png", **manifest: object) -> Path:
    """Return a run with every kind of file that came to its end."""
    recorder = begin(runs_dir, name, store, **manifest)
    recorder.can_frames(CAN_FRAMES)
    fill(recorder)
    recorder.close("success", "", ENDED)
    return recorder.path


def interrupted_run(runs_dir: Path, name: str = "run", store: Store = "png") -> Path:
    """Return a run that was left where it stood."""
    recorder = begin(runs_dir, name, store)
    fill(recorder)
    return recorder.path


def killed_run(runs_dir: Path, name: str = "run", *, trials: int = 2, trials_planned: int = 3) -> Path:
    """Return a run that was left in the middle of a trial, with no process that still holds it."""
    recorder = begin(runs_dir / "writing", name, trials_planned=trials_planned)
    recorder.can_frames(CAN_FRAMES)
    fill(recorder, trials)
    recorder.event("trial_start", 10.0 * trials, trial=trials, specimen="gel 10", hole=trials)
    path = Path(shutil.copytree(recorder.path, runs_dir / name))
    recorder.close("aborted", "", ENDED)
    shutil.rmtree(runs_dir / "writing")
    return path


def flip_bit(path: Path) -> None:
    """Change a bit in the middle of a file, as a bad disk does."""
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)
