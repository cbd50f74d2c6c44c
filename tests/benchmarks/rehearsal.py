"""A rehearsal of one gel in real time: eighteen insertions of 40 mm, as the paper's sweep makes them into each gel.

One labrig serves the rig; another one runs the sweep at a terminal. Its questions are answered as soon as they are
shown. The radii are compared with those that the world drew. By can.log: the time from an SDO request to its response,
while the same computer draws the pictures; and the longest time between two heartbeats of labrig. The drives wait
longer for a beat than by default, so that a busy machine is measured and does not end the run.
"""

import json
import statistics
import tempfile
import time
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import psutil

from labrig.devices.can_description import HeartbeatDescription
from labrig.devices.rig_file import load_rig
from labrig.simulation.world import World
from tests.benchmarks.table import print_rows
from tests.rehearsing import ROOT, Ended, ServingRig, serve_rehearsal

INSERTIONS = 18
SEED = 7
_SPECIMEN, _GELATIN_PERCENT = "gel 13 %", 13
_SLOWEST_S = 120.0
"""Longest time that an insertion may take, before the run is given up."""

_RESPONSE, _REQUEST, _HEARTBEAT = 0x580, 0x600, 0x700


def print_table(insertions: int = INSERTIONS) -> None:
    """Print what was asked and measured, and how long answers, pictures and the whole took."""
    with tempfile.TemporaryDirectory() as folder:
        runs = Path(folder) / "runs"
        with serve_rehearsal(Path(folder) / "rig", "--seed", str(SEED)) as bench:
            started_s, simulation = time.perf_counter(), psutil.Process(bench.process.pid)
            done = _insert(bench, runs, insertions)
            wall_s, times = time.perf_counter() - started_s, simulation.cpu_times()
        if done.exit_code:
            raise RuntimeError(f"the run ended with {done.exit_code}:\n{done.shown[-3000:]}")
        (run,) = (path for path in runs.iterdir() if (path / "manifest.json").is_file())
        rows: list[list[object]] = [
            ["insertions", insertions],
            ["whole run, from start to exit, s", f"{wall_s:.1f}"],
            ["processor time of the simulation, of one core", f"{(times.user + times.system) / wall_s:.0%}"],
            *_compare_radii(run, insertions),
            *_time_frames(run, load_rig(bench.rig).can.heartbeat.computer_node_id),
        ]
    print_rows(("a rehearsal of one gel", ""), rows)


def _insert(bench: ServingRig, runs: Path, insertions: int) -> Ended:
    settings = (
        f"specimens=[{{name: {_SPECIMEN}, gelatin_percent: {_GELATIN_PERCENT}}}]",
        f"insertions_per_specimen={insertions}",
    )
    options = [word for setting in settings for word in ("--set", setting)]
    return bench.run(
        "run",
        ROOT / "protocols" / "steerability.yaml",
        *("--rig", bench.rig, "--runs-dir", runs, *options),
        answer=bench.obeys,
        patience_s=_SLOWEST_S * insertions,
    )


def _compare_radii(run: Path, insertions: int) -> Iterator[list[object]]:
    """Yield how many radii were measured, and how far they are from those that the world drew."""
    result = json.loads((run / "analysis" / "001" / "result.json").read_text())
    measured = {
        measurement["trial"]: measurement["radius_mm"]
        for measurement in result["measurements"]
        if measurement["accepted"]
    }
    drawn = _draw_radii(insertions)
    errors = [radius_mm - drawn[trial] for trial, radius_mm in measured.items()]
    yield ["radii measured", len(errors)]
    yield ["mean error of a radius, mm", f"{statistics.mean(errors):+.3f}"]
    yield ["largest error of a radius, mm", f"{max(map(abs, errors)):.3f}"]


def _draw_radii(insertions: int) -> list[float]:
    """Return the radii [mm] that the served world drew, by their holes."""
    description = load_rig(ROOT / "calibration" / "rig-simulated.yaml").world
    assert description is not None
    world = World(description, SEED)
    world.mount_needle("N1")
    world.place_specimen(_SPECIMEN, _GELATIN_PERCENT)
    radii = []
    for hole in range(insertions):
        world.shift_to_hole(_SPECIMEN, hole, 10.0 * hole)
        radii.append(float(str(world.truth()["radius_mm"])))
    return radii


def _time_frames(run: Path, computer_node_id: int) -> Iterator[list[object]]:
    """Yield the time that drives took to answer, and that between two heartbeats of labrig."""
    asked_s: dict[int, float] = {}
    took_ms, beats_s = [], []
    for line in (run / "can.log").read_text(encoding="utf-8").splitlines():
        t_s, cob_id = _read_frame(line)
        function, node_id = cob_id & 0x780, cob_id & 0x7F
        if function == _REQUEST:
            asked_s[node_id] = t_s
        elif function == _RESPONSE and node_id in asked_s:
            took_ms.append(1000 * (t_s - asked_s.pop(node_id)))
        elif cob_id == _HEARTBEAT + computer_node_id:
            beats_s.append(t_s)
    took_ms.sort()
    yield ["answers of the drives", len(took_ms)]
    yield ["median, 99 %, longest answer, ms", _format_quantiles(took_ms)]
    longest_s = max(after - before for before, after in pairwise(beats_s))
    default_ms = HeartbeatDescription().timeout_ms
    yield [
        f"longest time between two heartbeats, ms; by default at most {default_ms}",
        f"{1000 * longest_s:.0f}",
    ]


def _read_frame(line: str) -> tuple[float, int]:
    """Return rig time [s] and COB-ID of a line of can.log."""
    time_text, _, frame, *_ = line.split()
    return float(time_text.strip("()")), int(frame.partition("#")[0], 16)


def _format_quantiles(sorted_ms: list[float]) -> str:
    last = len(sorted_ms) - 1
    return ", ".join(f"{sorted_ms[round(part * last)]:.1f}" for part in (0.5, 0.99, 1.0))
