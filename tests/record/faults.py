"""Records as faults leave them: killed writers, files cut anywhere, flipped bits; and what reading them may do."""

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from labrig.errors import LabrigError
from labrig.record.check import check_run
from labrig.record.pictures import Store
from labrig.record.reader import Run, open_run
from tests.record.runs import ENDED, begin, fill

CAN_FRAMES = [(0.0, 0x601, bytes([0x40, 0x41, 0x60, 0, 0, 0, 0, 0]), "T"), (0.001, 0x581, bytes(8), "R")]

RAW_FILES = (
    "manifest.json", "protocol.yaml", "rig.yaml", "calibration/intrinsics.json", "frames/000001.png",
    "frames.jsonl", "states.jsonl", "events.jsonl", "truth.jsonl", "can.log", "can.sums.jsonl",
)  # fmt: skip


def raw_files(store: Store) -> tuple[str, ...]:
    """Return a file of every kind that a run of `full_run` has."""
    return RAW_FILES if store == "png" else tuple(_IN_RAW.get(name, name) for name in RAW_FILES)


_IN_RAW = {"frames/000001.png": "frames.raw"}


def full_run(runs_dir: Path, *, closed: bool, store: Store = "png") -> Path:
    """Return a run with every kind of file in it; an open one is a copy, as a killed process would leave it."""
    recorder = begin(runs_dir, "written", store)
    recorder.can_frames(CAN_FRAMES)
    fill(recorder)
    recorder.can_frames([(20.0 + t_s, can_id, data, way) for t_s, can_id, data, way in CAN_FRAMES])
    copy = runs_dir / "run"
    if not closed:
        shutil.copytree(recorder.path, copy)
    recorder.close("success", "", ENDED)
    if closed:
        shutil.copytree(recorder.path, copy)
    shutil.rmtree(recorder.path)
    return copy


def flip_bit(path: Path) -> None:
    """Change a bit in the middle of a file, as a bad disk does."""
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)


def killed_run(runs_dir: Path, name: str = "run", *, trials: int = 2) -> Path:
    """Return a run that was left in the middle of a trial, with no process that still holds it."""
    recorder = begin(runs_dir / "writing", name)
    recorder.can_frames(CAN_FRAMES)
    fill(recorder, trials)
    recorder.event("trial_start", 10.0 * trials, trial=trials, specimen="gel 10", hole=trials)
    path = Path(shutil.copytree(recorder.path, runs_dir / name))
    recorder.close("aborted", "", ENDED)
    shutil.rmtree(runs_dir / "writing")
    return path


Values = dict[str, object]


def values(run: Run) -> Values:
    """Return all that a run says, for comparison."""
    return {
        "manifest": run.manifest,
        "protocol": run.protocol,
        "rig": None if run.rig_path is None else run.rig_path.read_bytes(),
        "calibration": run.calibration_path("intrinsics.json").read_bytes(),
        "states": _rows(run.states),
        "events": _rows(run.events),
        "truth": _rows(run.truth),
        "frames": _rows(run.frame_table),
        "can": list(run.can_frames),
        "pictures": [np.asarray(picture).tobytes() for picture in run.frames],
    }


def _rows(table: pd.DataFrame) -> list[dict[str, object]]:
    return [
        {str(key): value for key, value in row.items() if value is not None and not _missing(value)}
        for row in table.to_dict("records")
    ]


def _missing(value: Any) -> bool:
    return bool(pd.api.types.is_scalar(value) and pd.isna(value))


def is_noticed_or_unchanged(path: Path, original: Values) -> bool:
    """Return whether the run is refused by a named error, tells of damage, or says what it said before.

    Any other exception is left to whoever calls. Lists may be shorter, where an open run has lost its end.
    """
    try:
        run = open_run(path)
        if run.problems:
            return True
        found = values(run)
    except LabrigError as error:
        return bool(error.message)
    return all(_same(found[key], original[key]) for key in original)


def _same(found: object, original: object) -> bool:
    if isinstance(found, list) and isinstance(original, list):
        return found == original[: len(found)]
    return found == original


def describe_damage(run: Path) -> str:
    """Return what a check says, be it by refusing; nothing but a named error may leave it."""
    try:
        return "\n".join(f"{problem.where}: {problem.message}" for problem in check_run(run).damage)
    except LabrigError as error:
        return error.message
