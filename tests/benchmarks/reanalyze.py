"""`labrig reanalyze` of many recorded frames on one core and on both: a run, and several runs together.

The number of frames is `LABRIG_BENCHMARK_FRAMES`, 1,000 unless set. One core and two take turns three times, so that
other load affects both; the ratio is that of the medians.
"""

import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import cv2

from tests.benchmarks.start_up import children_s
from tests.benchmarks.table import print_rows
from tests.vision.renderer import Gel, Needle, flat_camera

FRAMES = int(os.environ.get("LABRIG_BENCHMARK_FRAMES", "1000"))
DIFFERENT, SEVERAL, TURNS = 20, 8, 3


def print_table() -> None:
    """Print wall times on one core and on both, their ratio, and the share of one core's time that was waited."""
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for runs in (1, SEVERAL):
            arguments = _import(Path(folder) / str(runs), runs)
            turns = [(_measure(arguments, "0"), _measure(arguments, "0,1")) for _ in range(TURNS)]
            one_s, both_s = (statistics.median(turn[core][0] for turn in turns) for core in (0, 1))
            cpu_s = statistics.median(turn[0][1] for turn in turns)
            waited = f"{100.0 * (1.0 - cpu_s / one_s):.0f}"
            rows.append(
                [
                    f"{runs} of {FRAMES // runs}",
                    f"{one_s:.1f}",
                    f"{both_s:.1f}",
                    f"{one_s / both_s:.2f}",
                    "1.7",
                    waited,
                ]
            )
    print_rows(("runs of frames", "one core s", "both s", "ratio", "at least", "waited %"), rows)
    print("waited above 5 %: the machine was not quiet")


def _import(folder: Path, runs: int) -> list[str]:
    """Return runs of rendered pictures that repeat a few pictures and together hold all frames."""
    camera = flat_camera(15.0, (1280, 720))
    needles = (Needle(27.0 + 0.1 * n, entry_mm=(21.0, 13.0)) for n in range(DIFFERENT))
    drawn = [
        cv2.imencode(".png", Gel(needle, camera).take(n))[1].tobytes() for n, needle in enumerate(needles)
    ]
    for run in range(runs):
        pictures = folder / "pictures" / f"{run:02d}"
        pictures.mkdir(parents=True)
        for number in range(FRAMES // runs):
            (pictures / f"{number:06d}.png").write_bytes(drawn[number % DIFFERENT])
    scale = ["--px-per-mm", "15", "--insertion", "right"]
    place = ["--origin-px", "315", "195", "--sheath-diameter-mm", "2", "--runs-dir", str(folder / "runs")]
    command = [sys.executable, "-m", "labrig", "import", str(folder / "pictures"), *scale, *place]
    subprocess.run(command, check=True, capture_output=True)
    return sorted(str(run) for run in (folder / "runs").iterdir() if run.is_dir())


def _measure(arguments: list[str], cores: str) -> tuple[float, float]:
    """Return wall and processor time [s] of the command on these cores."""
    command = ["taskset", "-c", cores, sys.executable, "-m", "labrig", "reanalyze", *arguments]
    before_s, started = children_s(), time.perf_counter()
    subprocess.run(command, check=True, capture_output=True)
    return time.perf_counter() - started, children_s() - before_s
