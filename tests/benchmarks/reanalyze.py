"""`labrig reanalyze` of many recorded frames on one core and on both."""

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import cv2

from tests.benchmarks.table import print_rows
from tests.vision.rendering import Bench, Gel, Lens, Needle

FRAMES = int(os.environ.get("LABRIG_BENCHMARK_FRAMES", "1000"))
DIFFERENT = 20


def print_table() -> None:
    """Wall time on one core and on two, their ratio, and whether progress was shown."""
    with tempfile.TemporaryDirectory() as folder:
        run = _imported(Path(folder))
        one_s, _ = _reanalyzed(run, "0")
        both_s, said = _reanalyzed(run, "0,1")
    rows: list[list[object]] = [
        [f"{FRAMES} frames on one core, s", f"{one_s:.1f}", "-"],
        ["on both cores, s", f"{both_s:.1f}", "-"],
        ["ratio", f"{one_s / both_s:.2f}", "1.7"],
        ["progress shown", f"{FRAMES} of {FRAMES} pictures" in said or "%" in said, "True"],
    ]
    print_rows(("figure", "measured", "limit"), rows)


def _imported(folder: Path) -> Path:
    """Return a run of rendered pictures, a few of them over and over."""
    pictures = folder / "pictures"
    pictures.mkdir()
    lens = Lens(k1=0.0, k2=0.0, tilt_rad=0.0)
    bench = Bench(lens)
    drawn = [
        cv2.imencode(".png", bench.picture(Needle(27.0 + 0.1 * n), Gel(), n))[1].tobytes()
        for n in range(DIFFERENT)
    ]
    for number in range(FRAMES):
        (pictures / f"{number:06d}.png").write_bytes(drawn[number % DIFFERENT])
    scale = ["--px-per-mm", f"{lens.focal_px / lens.distance_mm:.4f}", "--insertion", "right"]
    place = ["--origin-px", "320", "200", "--sheath-diameter-mm", "2", "--runs-dir", str(folder / "runs")]
    command = [sys.executable, "-m", "labrig", "import", str(pictures), *scale, *place]
    subprocess.run(command, check=True, capture_output=True)
    return next((folder / "runs").iterdir())


def _reanalyzed(run: Path, cores: str) -> tuple[float, str]:
    """Return the wall time [s] on these cores, and what was said meanwhile."""
    started = time.perf_counter()
    command = ["taskset", "-c", cores, sys.executable, "-m", "labrig", "reanalyze", str(run)]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    return time.perf_counter() - started, done.stderr
