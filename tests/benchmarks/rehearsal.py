"""A rehearsal of one gel in real time: eighteen insertions of 40 mm, as the paper's sweep makes them into each gel.

Its questions are answered as soon as they are shown. The radii are compared with those that the world drew. By can.log:
the longest time between two heartbeats of labrig, whose process also simulates the drives and draws the pictures. The
drives wait longer for a beat than by default, so that a busy machine is measured and does not end the run.
"""

import json
import resource
import statistics
import tempfile
import time
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

from labrig.devices.can_description import HeartbeatDescription
from labrig.record.reader import open_run
from tests.benchmarks.table import print_rows
from tests.rehearsing import ROOT, run_at_terminal

INSERTIONS = 18
SEED = 7
_SPECIMEN, _GELATIN_PERCENT = "gel 13 %", 13
_SLOWEST_S = 120.0
"""Longest time that an insertion may take, before the run is given up."""

_BEAT = 0x700 + HeartbeatDescription().computer_node_id


def print_table(insertions: int = INSERTIONS) -> None:
    """Print what was measured, and how long beats and the whole took."""
    settings = (
        "specimens=[{name: gel 13 %, gelatin_percent: 13}]",
        f"insertions_per_specimen={insertions}",
        "rig.clock=real",
        "rig.can.heartbeat.timeout_ms=10000",
    )
    with tempfile.TemporaryDirectory() as runs:
        started_s = time.perf_counter()
        done = run_at_terminal(
            "run", ROOT / "protocols" / "steerability.yaml", "--rig", ROOT / "calibration" / "rig-simulated.yaml",
            "--runs-dir", runs, "--run-name", "r", "--seed", SEED,
            *(word for setting in settings for word in ("--set", setting)),
            patience_s=_SLOWEST_S * insertions,
        )  # fmt: skip
        wall_s, used = time.perf_counter() - started_s, resource.getrusage(resource.RUSAGE_CHILDREN)
        if done.exit_code:
            raise RuntimeError(f"the run ended with {done.exit_code}:\n{done.shown[-3000:]}")
        rows: list[list[object]] = [
            ["insertions", insertions],
            ["whole run, from start to exit, s", f"{wall_s:.1f}"],
            ["processor time, of one core", f"{(used.ru_utime + used.ru_stime) / wall_s:.0%}"],
            *_compare_radii(Path(runs) / "r"),
            *_time_beats(Path(runs) / "r"),
        ]
    print_rows(("a rehearsal of one gel", ""), rows)


def _compare_radii(run: Path) -> Iterator[list[object]]:
    """Yield how many radii were measured, and how far they are from those that the world drew."""
    result = json.loads((run / "analysis" / "001" / "result.json").read_text())
    drawn_mm = {line["trial"]: line["radius_mm"] for line in open_run(run).lines("truth")}
    measured_mm = {
        measurement["trial"]: measurement["radius_mm"]
        for measurement in result["measurements"]
        if measurement["accepted"]
    }
    errors_mm = [radius_mm - drawn_mm[trial] for trial, radius_mm in measured_mm.items()]
    yield ["radii measured", len(errors_mm)]
    yield ["mean error of a radius, mm", f"{statistics.mean(errors_mm):+.3f}"]
    yield ["largest error of a radius, mm", f"{max(map(abs, errors_mm)):.3f}"]


def _time_beats(run: Path) -> Iterator[list[object]]:
    """Yield the longest time between two heartbeats of labrig."""
    beats_s = [frame.t_s for frame in open_run(run).can_frames if frame.can_id == _BEAT]
    longest_s = max(after - before for before, after in pairwise(beats_s))
    default_ms = HeartbeatDescription().timeout_ms
    yield [
        f"longest time between two heartbeats, ms; by default at most {default_ms}",
        f"{1000 * longest_s:.0f}",
    ]
