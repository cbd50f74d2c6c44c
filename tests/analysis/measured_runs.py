"""Runs with a result, written by the record room's own Recorder; nothing was photographed or measured."""

import csv
import io
import json
from collections.abc import Mapping, Sequence
from pathlib import Path

from labrig.record.results import finish_result, new_result_dir
from labrig.record.writer import Recorder, opening_files
from tests.record.runs import ENDED, STARTED, picture

SIGMAS_MM = {"lens": 0.03, "plane": 0.04, "surface": None, "roll": 0.12, "lighting": 0.01, "fit": 0.05}
COLUMNS = [
    "frame", "role", "trial", "specimen", "gelatin_percent", "hole", "needle_id", "accepted", "reason", "radius_mm",
    *(f"sigma_radius_{source}_mm" for source in SIGMAS_MM),
]  # fmt: skip
PROTOCOL_YAML = "experiment: import\nseed: 7\ninsertion: {speed_mm_s: 1.0}\n"


def write_measured_run(
    runs_dir: Path,
    name: str,
    radii_mm: Mapping[tuple[str, float], Sequence[float | None]],
    *,
    needle_id: str = "N1",
    plane: bytes = b"{}",
    settings: Mapping[str, object] | None = None,
    overrides: Sequence[str] = (),
    result: bool = True,
    bad: Mapping[int, str] | None = None,
    with_file: Sequence[str] = (),
    protocol: str = "",
    rig: str = "bench",
    quantity: str = "radius_mm",
    final: bool = True,
) -> Path:
    """Write a run with these radii in each (specimen, gelatin %), None for a refused one, and return its folder.

    Each trial has a picture on the way, whose radius of 99 mm must not count, and a final one. `with_file` names the
    specimens that have a file; `protocol` is added to the run's. Not `final`: no picture is told to be the final one.
    """
    calibration = {"intrinsics.json": b'{"fx": 1.0}', "plane.json": plane}
    manifest = {
        "experiment": "import", "started": STARTED, "title": name, "trials_planned": 3, "seed": 7,
        "rig": {"kind": rig},
    }  # fmt: skip
    blocks = ", ".join(f'{{block: {{name: "{specimen}"}}}}' for specimen in with_file)
    protocol += f"specimens: [{blocks}]\n" if with_file else ""
    files = opening_files(PROTOCOL_YAML + protocol, f"kind: {rig}\n", calibration)
    recorder = Recorder.create(runs_dir, name, manifest, files)
    rows: list[list[object]] = []
    for (specimen, gelatin), values in radii_mm.items():
        for hole, radius_mm in enumerate(values):
            trial, reason = len(rows) // 2, "too faint" if radius_mm is None else None
            named = {"specimen": specimen, "gelatin_percent": gelatin, "hole": hole, "needle_id": needle_id}
            recorder.event("trial_start", 60.0 * trial, trial=trial, **named)
            for role, found, why in (("advance", 99.0, None), ("final", radius_mm, reason)):
                number, shown = len(rows), {"trial": trial, "role": role, "insertion_mm": 40.0}
                recorder.frame(picture(number), 60.0 * trial + 40.0, **shown)
                told = (number, role, trial, *named.values(), found is not None, why, found)
                rows.append([*told, *SIGMAS_MM.values()])
            stopped = {"trial": trial, "exit_status": "success"} | (
                {"final_frame": len(rows) - 1} if final else {}
            )
            recorder.event("trial_stop", 60.0 * trial + 50.0, **stopped)
            if trial in (bad or {}):
                recorder.event("mark_bad", 60.0 * trial + 55.0, trial=trial, reason=(bad or {})[trial])
    recorder.close("success", "", ENDED)
    if result:
        heads = [quantity if name == "radius_mm" else name for name in COLUMNS]
        _add_result(recorder.path, heads, rows, settings=settings or {}, overrides=list(overrides))
    return recorder.path


def _add_result(
    run: Path, heads: Sequence[str], rows: Sequence[Sequence[object]], **document: object
) -> None:
    """Write a result with its table."""
    folder = new_result_dir(run)
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([heads, *rows])
    (folder / "measurements.csv").write_text(text.getvalue(), encoding="utf-8")
    columns = [{"name": name, "unit": None} for name in heads]
    listed = {"measurements": {"file": "measurements.csv", "columns": columns, "rows": len(rows)}}
    (folder / "tables.json").write_text(json.dumps(listed), encoding="utf-8")
    document["not_in_interval"] = ["surface"]
    (folder / "result.json").write_text(json.dumps(document), encoding="utf-8")
    finish_result(folder)
