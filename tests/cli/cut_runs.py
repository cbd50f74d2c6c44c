"""Runs as a power cut leaves them, made from finished ones."""

import json
import shutil
from pathlib import Path

from labrig.record.json_lines import checksum, encode_document


def cut_short(run: Path, to: Path, after_s: float) -> Path:
    """Copy a finished run as it would stand if the power had gone at a rig time: open, its last event torn."""
    shutil.copytree(run, to, ignore=shutil.ignore_patterns("analysis", "SHA256SUMS", "report.html"))
    for name in ("frames.jsonl", "states.jsonl", "events.jsonl"):
        lines = (to / name).read_bytes().splitlines(keepends=True)
        kept = [line for line in lines if json.loads(line)["t_s"] <= after_s]
        torn = lines[len(kept)][:-9] if name == "events.jsonl" and len(kept) < len(lines) else b""
        (to / name).write_bytes(b"".join(kept) + torn)
    frames = len((to / "frames.jsonl").read_bytes().splitlines())
    for picture in sorted((to / "frames").iterdir())[frames:]:
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
    if not (run / "can.log").exists():
        return
    content = (run / "can.log").read_bytes()
    sums = (run / "can.sums.jsonl").read_bytes().splitlines(keepends=True)
    ends = [json.loads(line)["bytes"] for line in sums]
    times = [float(content[:end].splitlines()[-1][1:].split(b")")[0]) for end in ends]
    kept = sum(t_s <= after_s for t_s in times)
    (run / "can.sums.jsonl").write_bytes(b"".join(sums[:kept]))
    (run / "can.log").write_bytes(content[: [0, *ends][kept]])


def open_again(run: Path) -> None:
    """Take the manifest and the chain back to what they are before a run is closed."""
    links = (run / "chain.jsonl").read_bytes().splitlines(keepends=True)
    closing = next(index for index, link in enumerate(links) if json.loads(link)["kind"] == "close")
    (run / "chain.jsonl").write_bytes(b"".join(links[:closing]))
    document = json.loads((run / "manifest.json").read_text(encoding="utf-8"))
    document |= {"exit_status": "incomplete", "reason": None, "ended": None, "trials_done": 0}
    document |= {"run": run.name}
    del document["crc32"]
    (run / "manifest.json").write_bytes(encode_document({**document, "crc32": checksum(document)}))
