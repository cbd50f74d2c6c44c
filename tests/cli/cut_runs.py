"""Runs as a power cut leaves them, made from finished ones."""

import json
import shutil
from pathlib import Path

from labrig.record.json_lines import encode_manifest
from labrig.record.layout import encode_sums, is_opening_file, read_sums


def cut_short(run: Path, to: Path, after_s: float) -> Path:
    """Copy a finished run as it would stand if the power had gone at a rig time: open, its last event torn."""
    shutil.copytree(run, to, ignore=shutil.ignore_patterns("analysis", "report.html"))
    for name in ("frames.jsonl", "states.jsonl", "events.jsonl"):
        lines = (to / name).read_bytes().splitlines(keepends=True)
        kept = [line for line in lines if json.loads(line)["t_s"] <= after_s]
        torn = lines[len(kept)][:-9] if name == "events.jsonl" and len(kept) < len(lines) else b""
        (to / name).write_bytes(b"".join(kept) + torn)
    for picture in sorted((to / "frames").iterdir())[len((to / "frames.jsonl").read_bytes().splitlines()) :]:
        picture.unlink()
    _cut_truth(to)
    _cut_can(to, after_s)
    open_again(to)
    return to


def _cut_truth(run: Path) -> None:
    """Keep the truth of the trials whose final picture is there: it is told right after that."""
    if not (run / "truth.jsonl").exists():
        return
    frames = [json.loads(line) for line in (run / "frames.jsonl").read_bytes().splitlines()]
    finals = sum(frame["role"] == "final" for frame in frames)
    lines = (run / "truth.jsonl").read_bytes().splitlines(keepends=True)
    (run / "truth.jsonl").write_bytes(b"".join(lines[:finals]))


def _cut_can(run: Path, after_s: float) -> None:
    if (run / "can.log").exists():
        lines = (run / "can.log").read_bytes().splitlines(keepends=True)
        kept = [line for line in lines if float(line[1:].split(b")")[0]) <= after_s]
        (run / "can.log").write_bytes(b"".join(kept))


def open_again(run: Path) -> None:
    """Take manifest and sums back to what they are before a run is closed."""
    sums = {name: sha256 for name, sha256 in read_sums(run).items() if is_opening_file(name)}
    (run / "SHA256SUMS").write_bytes(encode_sums(sums))
    document = json.loads((run / "manifest.json").read_text(encoding="utf-8"))
    document |= {"exit_status": "incomplete", "reason": None, "ended": None, "summary": None, "run": run.name}
    (run / "manifest.json").write_bytes(encode_manifest(document))
