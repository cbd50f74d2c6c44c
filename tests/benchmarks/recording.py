"""Recording in real time: 1280x720 at 30 pictures a second and 100 states a second, as PNG and raw.

``python -m tests.benchmarks recording`` takes a minute; ``python -m tests.benchmarks.recording 600`` ten minutes of
each, and about 9 GB and 17 GB of the disk for temporary files while it runs.
"""

import sys
import tempfile
import time
from dataclasses import dataclass
from itertools import count
from pathlib import Path

import psutil

from labrig.devices.clocks import SystemClock
from labrig.devices.rig_file import load_rig
from labrig.record.check import check_run
from labrig.record.pictures import Picture, Store
from labrig.record.reader import open_run
from labrig.record.writer import Recorder
from labrig.simulation.world import World
from tests.benchmarks.table import print_rows
from tests.record.runs import ENDED, begin

RIG = Path(__file__).parents[2] / "calibration" / "rig-simulated.yaml"
DURATION_S = 30.0
PICTURES_HZ = 30
STATES_HZ = 100
# OpenCV asks a V4L2 camera for four buffers: a picture is lost when the fourth after it is due.
CAMERA_BUFFERS = 4
LATEST_S = CAMERA_BUFFERS / PICTURES_HZ
PICTURES = 20
LIMITS: dict[Store, float] = {"pgm": 0.30, "png": 0.60}
MOST_GROWTH_MB = 20.0


@dataclass(frozen=True)
class Recorded:
    """The cost of a recording."""

    cpu: float
    frames: int
    dropped: int
    worst_late_ms: float
    growth_mb: float
    disk_mb: float
    closing_s: float
    sound: bool


def print_table(duration_s: float = DURATION_S) -> None:
    """Print processor time, late pictures and growth of memory for each store."""
    pictures = _draw_pictures()
    rows: list[list[object]] = []
    for store, limit in LIMITS.items():
        with tempfile.TemporaryDirectory() as folder:
            found = _record(begin(Path(folder), store=store), pictures, duration_s)
        rows += [
            [f"{store}: processor [% of one core]", f"{100 * found.cpu:.1f}", f"{100 * limit:.0f}"],
            [f"{store}: pictures dropped of {found.frames}", found.dropped, 0],
            [f"{store}: latest picture [ms late]", f"{found.worst_late_ms:.1f}", f"{1000 * LATEST_S:.1f}"],
            [f"{store}: growth of memory [MB]", f"{found.growth_mb:.1f}", f"{MOST_GROWTH_MB:.0f}"],
            [f"{store}: disk [MB]", f"{found.disk_mb:.0f}", "-"],
            [f"{store}: closing, the run's own check included [s]", f"{found.closing_s:.2f}", "-"],
            [f"{store}: record sound when closed", found.sound, True],
        ]
    what = f"{duration_s:.0f} s of {_size(pictures[0])} at {PICTURES_HZ} Hz, states at {STATES_HZ} Hz"
    print_rows([what, "measured", "limit"], rows)


def _size(picture: Picture) -> str:
    height, width = picture.shape[:2]
    return f"{width}x{height}"


def _draw_pictures() -> list[Picture]:
    """Draw the simulated camera's pictures beforehand, so that only the recording is measured."""
    description = load_rig(RIG).world
    assert description is not None
    world = World(description, seed=1)
    return [world.picture(1.0) for _ in range(PICTURES)]


def _record(recorder: Recorder, pictures: list[Picture], duration_s: float) -> Recorded:
    """Record in real time, and count the pictures that the camera would have lost."""
    clock, process = SystemClock(), psutil.Process()
    late_s: list[float] = []
    warm_mb = 0.0
    started_cpu_s, states = time.process_time(), 0
    for number in count():
        due_s = number / PICTURES_HZ
        if due_s >= duration_s:
            break
        while states / STATES_HZ <= due_s:
            _wait_until(clock, states / STATES_HZ)
            _state(recorder, states / STATES_HZ)
            states += 1
        _wait_until(clock, due_s)
        late_s.append(clock.now_s() - due_s)
        picture = pictures[number % len(pictures)].copy()
        recorder.frame(picture, due_s, trial=None, role="advance", insertion_mm=1.0)
        if number == int(0.2 * duration_s * PICTURES_HZ):
            warm_mb = process.memory_info().rss / 1e6
    cpu = (time.process_time() - started_cpu_s) / clock.now_s()
    growth_mb = process.memory_info().rss / 1e6 - warm_mb
    started_s = clock.now_s()
    recorder.close("success", "", ENDED)
    closing_s = clock.now_s() - started_s
    files = [path.stat().st_size for path in recorder.path.rglob("*") if path.is_file()]
    whole = len(open_run(recorder.path).frame_table) == len(late_s) and not check_run(recorder.path).damage
    dropped = sum(late >= LATEST_S for late in late_s)
    return Recorded(
        cpu, len(late_s), dropped, 1e3 * max(late_s), growth_mb, sum(files) / 1e6, closing_s, whole
    )


def _wait_until(clock: SystemClock, due_s: float) -> None:
    if (left_s := due_s - clock.now_s()) > 0:
        clock.sleep(left_s)


def _state(recorder: Recorder, t_s: float) -> None:
    recorder.state(
        t_s,
        insertion_mm=1.0 + t_s / 3,
        rotation_rad=0.1,
        linear_mm=15.0,
        insertion_statusword=0x8737,
        rotation_statusword=0x8737,
        linear_statusword=0x8737,
    )


if __name__ == "__main__":
    print_table(*map(float, sys.argv[1:]))
