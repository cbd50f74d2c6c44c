"""Runs to test with: a protocol, a manifest, and a short record."""

import json
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from labrig.record.opening import encode_manifest
from labrig.record.pictures import Store
from labrig.record.reader import open_run
from labrig.record.writer import Recorder

STARTED = datetime(2026, 3, 2, 9, 30, tzinfo=UTC)
ENDED = datetime(2026, 3, 2, 9, 45, tzinfo=UTC)

PROTOCOL_YAML = """\
experiment: import
seed: 7
needle: {needle_id: needle-a, diameter_mm: 1.2}
scale: {px_per_mm: 5.0, origin_px: [10, 20], insertion: right}
analysis: {window_start_mm: 4.0, window_end_mm: 2.0, min_window_mm: 15.0, max_radius_sigma_mm: 0.5}
"""


def begin(runs_dir: Path, name: str = "run", store: Store = "png", **manifest: object) -> Recorder:
    """Begin a run with two calibration files."""
    return Recorder.create(
        runs_dir,
        name,
        {"experiment": "import", "title": "Größe", "started": STARTED, "trials_planned": 3, "seed": 7}
        | manifest,
        PROTOCOL_YAML,
        "world: {}\n",
        {"intrinsics.json": b'{"fx": 1.0}', "plane.json": b"{}"},
        picture_store=store,
    )


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
            recorder.state(start_s + step, insertion_mm=np.float64(step) / 3, statusword=np.int64(0x0237))
        recorder.frame(picture(2 * trial), start_s + 3, trial=trial, role="advance", insertion_mm=1.0)
        final = recorder.frame(
            picture(2 * trial + 1), start_s + 4, trial=trial, role="final", insertion_mm=2.0
        )
        recorder.truth(trial=trial, radius_mm=27.5 + trial, tip_mm=np.array([1.0, 2.0]))
        recorder.event("trial_stop", start_s + 5, trial=trial, exit_status="success", final_frame=final)
    recorder.event("run_stop", 10.0 * trials)


def add_result(run: Path, content: bytes) -> Path:
    """Write a result and its link, as an analysis does, and return its folder."""
    opened = open_run(run)
    folder = opened.new_result_dir()
    (folder / "result.json").write_bytes(content)
    opened.seal_result(folder, "2026-03-02T10:00:00+00:00")
    return folder


def without_chain(run: Path) -> Path:
    """Return the run as an earlier labrig, which knew no chain, would have written it."""
    (run / "chain.jsonl").unlink()
    manifest = json.loads((run / "manifest.json").read_bytes())
    del manifest["hashes"]["first_link_sha256"], manifest["crc32"]
    (run / "manifest.json").write_bytes(encode_manifest(manifest))
    return run


def closed_run(runs_dir: Path, name: str = "run", store: Store = "png", **manifest: object) -> Path:
    """Return a run that came to its end."""
    recorder = begin(runs_dir, name, store, **manifest)
    fill(recorder)
    recorder.close("success", "", ENDED)
    return recorder.path


def interrupted_run(runs_dir: Path, name: str = "run", store: Store = "png") -> Path:
    """Return a run that was left where it stood."""
    recorder = begin(runs_dir, name, store)
    fill(recorder)
    return recorder.path
