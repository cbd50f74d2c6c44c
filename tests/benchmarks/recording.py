"""Recording in real time: 1280x720 at 30 pictures a second and 100 states a second, as PNG and raw.

It takes a minute; LABRIG_BENCHMARK_TIMES=20 takes ten minutes of each, and 9 GB and 17 GB of the disk while it runs.
"""

import tempfile
import time
from itertools import count
from pathlib import Path

from labrig.devices.clocks import SystemClock
from labrig.devices.rig_file import load_rig
from labrig.record.check import check_run
from labrig.record.pictures import Picture, Store
from labrig.record.reader import open_run
from labrig.record.writer import Recorder
from labrig.simulation.world import World
from tests.benchmarks.table import multiply, print_rows
from tests.record.runs import ENDED, begin

RIG = Path(__file__).parents[2] / "calibration" / "rig-simulated.yaml"
SECONDS = multiply(10)
PICTURES_HZ, STATES_HZ, PICTURES = 30, 100, 20
# OpenCV asks a V4L2 camera for four buffers: a picture is lost when the fourth after it is due.
LATEST_S = 4 / PICTURES_HZ
LIMITS: dict[Store, int] = {"pgm": 30, "png": 60}


def print_table() -> None:
    """Print processor time, late pictures and the end of the record for each store."""
    description = load_rig(RIG).world
    assert description is not None
    world = World(description, seed=1)
    pictures = [
        world.picture(1.0) for _ in range(PICTURES)
    ]  # drawn before, so that only the recording is measured
    rows: list[list[object]] = []
    for store, limit in LIMITS.items():
        with tempfile.TemporaryDirectory() as folder:
            recorder = begin(Path(folder), store=store)
            cpu, late_s = _record(recorder, pictures)
            started = time.perf_counter()
            recorder.close("success", "", ENDED)
            closing_s = time.perf_counter() - started
            whole = len(open_run(recorder.path).frame_table) == len(late_s)
            sound = whole and not check_run(recorder.path).damage
        dropped = sum(late >= LATEST_S for late in late_s)
        rows += [
            [f"{store}: processor [% of one core]", f"{100 * cpu:.1f}", limit],
            [f"{store}: pictures dropped of {len(late_s)}", dropped, 0],
            [f"{store}: latest picture [ms late]", f"{1000 * max(late_s):.1f}", f"{1000 * LATEST_S:.1f}"],
            [f"{store}: closing, the run's own check included [s]", f"{closing_s:.2f}", "-"],
            [f"{store}: record sound when closed", sound, True],
        ]
    what = f"{SECONDS:.0f} s of 1280x720 at {PICTURES_HZ} Hz, states at {STATES_HZ} Hz"
    print_rows([what, "measured", "limit"], rows)


def _record(recorder: Recorder, pictures: list[Picture]) -> tuple[float, list[float]]:
    """Record in real time; return processor time over elapsed time, and how late each picture was [s]."""
    clock, late_s, states = SystemClock(), list[float](), 0
    started_cpu_s = time.process_time()
    for number in count():
        due_s = number / PICTURES_HZ
        if due_s >= SECONDS:
            return (time.process_time() - started_cpu_s) / clock.now_s(), late_s
        while states / STATES_HZ <= due_s:
            _wait_until(clock, states / STATES_HZ)
            words = {f"{axis}_statusword": 0x8737 for axis in ("insertion", "rotation", "linear")}
            recorder.state(
                states / STATES_HZ, insertion_mm=due_s / 3, rotation_rad=0.1, linear_mm=15.0, **words
            )
            states += 1
        _wait_until(clock, due_s)
        late_s.append(clock.now_s() - due_s)
        picture = pictures[number % len(pictures)].copy()
        recorder.frame(picture, due_s, trial=None, role="advance", insertion_mm=1.0)
    raise AssertionError


def _wait_until(clock: SystemClock, due_s: float) -> None:
    if (left_s := due_s - clock.now_s()) > 0:
        clock.sleep(left_s)
