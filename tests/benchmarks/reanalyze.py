"""`labrig reanalyze` of many recorded frames on one core and on both: a run, and several runs together.

One core and two take turns three times, so that other load affects both; the ratio is that of the medians.
"""

import statistics
import sys
import tempfile
from pathlib import Path

import cv2

from tests.benchmarks.table import measure, multiply, print_rows
from tests.vision.renderer import Gel, Needle, flat_camera

FRAMES = multiply(200)
DIFFERENT, SEVERAL, TURNS = 20, 8, 3


def print_table() -> None:
    """Print wall times on one core and on both, their ratio, and the share of one core's time that was waited."""
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for runs in (1, SEVERAL):
            arguments = _import(Path(folder) / str(runs), runs)
            command = [sys.executable, "-m", "labrig", "reanalyze", *arguments]
            turns = [
                [measure(["taskset", "-c", cores, *command]) for cores in ("0", "0,1")] for _ in range(TURNS)
            ]
            one_s, both_s = (statistics.median(turn[core].wall_s for turn in turns) for core in (0, 1))
            waited = f"{100.0 * (1.0 - statistics.median(one.cpu_s for one, _ in turns) / one_s):.0f}"
            times = (f"{one_s:.1f}", f"{both_s:.1f}", f"{one_s / both_s:.2f}")
            rows.append([f"{runs} of {FRAMES // runs}", *times, "1.7", waited])
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
    measure([sys.executable, "-m", "labrig", "import", folder / "pictures", *scale, *place])
    return sorted(str(run) for run in (folder / "runs").iterdir() if run.is_dir())
