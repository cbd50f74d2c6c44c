"""`labrig reanalyze` of many recorded frames on one core and on both: a run, and several runs with a mask.

`python -m tests.benchmarks reanalyze`; the number of frames is `LABRIG_BENCHMARK_FRAMES`, 1,000 unless set. One core
and two take turns three times, so that other load affects both; the ratio is that of the medians.
"""

import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import cv2

from tests.benchmarks.table import print_rows
from tests.vision.rendering import RenderedBench, RenderedGel, RenderedLens, RenderedNeedle

FRAMES = int(os.environ.get("LABRIG_BENCHMARK_FRAMES", "1000"))
DIFFERENT = 20
SEVERAL = 8
TURNS = 3
LEAST_RATIO = 1.7
# Plain progress lines are at least two seconds apart.
LONG_ENOUGH_S = 6.0


@dataclass(frozen=True)
class _Timing:
    """Wall and processor time [s] of a command, and its standard error."""

    wall_s: float
    cpu_s: float
    stderr: str


def print_table() -> None:
    """Print wall times on one core and on both, their ratio, the serial share, and whether progress was shown."""
    with tempfile.TemporaryDirectory() as folder:
        single = _import(Path(folder) / "one", 1)
        several = _import(Path(folder) / "several", SEVERAL)
        rows = [
            _row(f"1 run of {FRAMES} frames", single),
            _row(f"{SEVERAL} runs of {FRAMES // SEVERAL} together", several),
        ]
    heads = ("", "one core s", "both s", "ratio", "limit", "serial %", "waited %", "progress")
    print_rows(heads, rows)
    print(
        "serial: the share of the time on one core that does not halve on two, 2 / ratio - 1; waited: of the time on\n"
        "one core, the share that the command waited for other load: above 5 % the machine was not quiet"
    )


def _row(what: str, arguments: list[str]) -> list[object]:
    turns = [(_reanalyze(arguments, "0"), _reanalyze(arguments, "0,1")) for _ in range(TURNS)]
    one_s, both_s = (statistics.median(turn[core].wall_s for turn in turns) for core in (0, 1))
    cpu_s = statistics.median(turn[0].cpu_s for turn in turns)
    shown = all("pictures" in turn[1].stderr and "left" in turn[1].stderr for turn in turns)
    return [
        what,
        f"{one_s:.1f}",
        f"{both_s:.1f}",
        f"{one_s / both_s:.2f}",
        f"{LEAST_RATIO}",
        f"{100.0 * (2.0 * both_s / one_s - 1.0):.0f}",
        f"{100.0 * (1.0 - cpu_s / one_s):.0f}",
        "shown" if shown else "not shown" if both_s > LONG_ENOUGH_S else "too short",
    ]


def _import(folder: Path, runs: int) -> list[str]:
    """Return runs of rendered pictures that repeat a few pictures and together hold all frames."""
    lens = RenderedLens(k1=0.0, k2=0.0, tilt_rad=0.0)
    bench = RenderedBench(lens)
    drawn = [
        cv2.imencode(".png", bench.picture(RenderedNeedle(27.0 + 0.1 * n), RenderedGel(), n))[1].tobytes()
        for n in range(DIFFERENT)
    ]
    for run in range(runs):
        pictures = folder / "pictures" / f"{run:02d}"
        pictures.mkdir(parents=True)
        for number in range(FRAMES // runs):
            (pictures / f"{number:06d}.png").write_bytes(drawn[number % DIFFERENT])
    scale = ["--px-per-mm", f"{lens.focal_px / lens.distance_mm:.4f}", "--insertion", "right"]
    place = ["--origin-px", "320", "200", "--sheath-diameter-mm", "2", "--runs-dir", str(folder / "runs")]
    command = [sys.executable, "-m", "labrig", "import", str(folder / "pictures"), *scale, *place]
    subprocess.run(command, check=True, capture_output=True)
    return sorted(str(run) for run in (folder / "runs").iterdir() if run.is_dir())


def _reanalyze(arguments: list[str], cores: str) -> _Timing:
    """Measure the command on these cores."""
    command = ["taskset", "-c", cores, sys.executable, "-m", "labrig", "reanalyze", *arguments]
    before_s, started = _children_s(), time.perf_counter()
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    return _Timing(time.perf_counter() - started, _children_s() - before_s, done.stderr)


def _children_s() -> float:
    """Return the processor time [s] of all finished commands and their child processes."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime
