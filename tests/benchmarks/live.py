"""What a live view costs the process that records: pictures of 1280x720 at 30 Hz, states at 100 Hz, alone and watched.

``python -m tests.benchmarks live`` takes a minute and a half. Each round records as long alone, beside a viewer, and
beside one that accepts and never reads, so that other programs on this computer burden all three alike.
"""

import statistics
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from labrig.cli.live import follow_in_viewer
from labrig.devices.clocks import SystemClock
from labrig.record.writer import Recorder, RunFiles
from labrig.report.viewer import find_viewer
from tests.analysis.synthetic import needle_picture, plane_file
from tests.benchmarks.table import print_rows
from tests.record.runs import ENDED, STARTED

ROOT = Path(__file__).parents[2]
ROUNDS = 3
PICTURES = 150
PICTURES_HZ = 30
STATES_A_PICTURE = 3
MOST_MS = 0.2
# The follower is measured at work, not while it loads its libraries.
WARM_UP_S = 6.0


def print_table() -> None:
    """Print the time of a frame in each case, and the ratio to recording alone."""
    pictures = [needle_picture(28.0, seed=seed) for seed in range(4)]
    times: dict[str, list[float]] = {}
    with tempfile.TemporaryDirectory() as folder:
        stalled = _write_stalled_viewer(Path(folder))
        watched = {"alone": None, "watched": find_viewer(), "watched by a viewer that never reads": stalled}
        for number in range(ROUNDS):
            for name, program in watched.items():
                recorder = _begin(Path(folder), f"{number}-{name.replace(' ', '-')}")
                times.setdefault(name, []).extend(_record(recorder, pictures, program))
    alone_ms = statistics.median(times["alone"])
    rows = []
    for name, taken in times.items():
        median_ms = statistics.median(taken)
        rows.append(
            [name, f"{median_ms:.3f}", f"{np.percentile(taken, 99):.2f}", f"{median_ms - alone_ms:+.3f}",
             "-" if name == "alone" else f"{MOST_MS:g}", f"{median_ms / alone_ms:.2f}"]
        )  # fmt: skip
    heads = ("ms a frame with its states", "median", "99 %", "more than alone", "limit", "ratio")
    print_rows(heads, rows)


def _record(recorder: Recorder, pictures: list[NDArray[np.uint8]], program: str | None) -> list[float]:
    """Record at the rate of a camera, and return how long each frame with its states took [ms]."""
    follower = None if program is None else follow_in_viewer(recorder.path, "viewer", program)
    clock, taken = SystemClock(), list[float]()
    if follower is not None:
        clock.sleep(WARM_UP_S)
    begin_s = clock.now_s()
    for number in range(PICTURES):
        due_s = begin_s + number / PICTURES_HZ
        clock.sleep(due_s - clock.now_s())
        started = time.perf_counter()
        recorder.frame(
            pictures[number % len(pictures)], due_s, trial=0, role="advance", insertion_mm=0.1 * number
        )
        for part in range(STATES_A_PICTURE):
            recorder.state(due_s + part / 100, insertion_mm=0.1 * number, insertion_statusword=0x0137)
        taken.append(1e3 * (time.perf_counter() - started))
    recorder.close("success", "", ENDED)
    if follower is not None:
        follower.finish()
    return taken


def _begin(folder: Path, name: str) -> Recorder:
    protocol = (ROOT / "protocols" / "steerability.yaml").read_text(encoding="utf-8")
    manifest = {
        "experiment": "steerability",
        "title": name,
        "started": STARTED,
        "trials_planned": 1,
        "seed": 1,
    }
    return Recorder.create(
        folder, name, manifest, RunFiles(protocol, None, {"plane.json": plane_file(folder)})
    )


def _write_stalled_viewer(folder: Path) -> str:
    program = folder / "rerun"
    command = f"cd '{ROOT}' && exec '{sys.executable}' -m tests.cli.stalled_viewer"
    program.write_text(f'#!/bin/sh\n{command} "$@"\n', encoding="utf-8")
    program.chmod(0o755)
    return str(program)
