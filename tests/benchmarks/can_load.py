"""The cost of watching three axes on a CAN bus: processor time of labrig over elapsed time."""

import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from labrig.devices.rig import Rig
from tests.benchmarks.table import print_rows
from tests.devices.served import bench_description, bench_rig

SECONDS, RATE_HZ = 10.0, 100.0


def print_table() -> None:
    """Print the load of reading three axes at 100 Hz and of an idle rig; another process serves the drives."""
    rows = []
    with open_served_rig() as rig:
        for what, limit, work in (("100 Hz status", 15, _read), ("idle", 2, _idle)):
            rate_hz, share = _measure(rig, work)
            rows.append([what, f"{rate_hz:.1f}", f"{100 * share:.1f}", f"{limit}"])
    print_rows(("over slcan", "Hz", "% of a core", "limit %"), rows)


@contextmanager
def open_served_rig() -> Iterator[Rig]:
    """Serve drives in another process, and open a rig whose needle moves."""
    command = [sys.executable, "-m", "labrig", "devices", "simulate", "--interface", "slcan"]
    with (
        tempfile.TemporaryDirectory() as folder,
        subprocess.Popen([*command, "--nodes", "1,2,3"], stdout=subprocess.PIPE, text=True) as serving,
    ):
        try:
            assert serving.stdout is not None
            channel = serving.stdout.readline().split()[-1]
            bus = {"interface": "slcan", "channel": channel, "sleep_after_open": 0}
            with bench_rig(bench_description(bus), Path(folder)) as rig:
                rig.reference_axes()
                rig.axis("insertion").start_move(100.0, 1.0)
                yield rig
                rig.close()
        finally:
            serving.terminate()


def _measure(rig: Rig, work: Callable[[Rig, float], None]) -> tuple[float, float]:
    """Return the rate [Hz] of the work, and processor time over elapsed time."""
    start_s, start_cpu_s, done = time.monotonic(), time.process_time(), 0
    while (passed_s := time.monotonic() - start_s) < SECONDS:
        work(rig, start_s + (done + 1) / RATE_HZ)
        done += 1
    return done / passed_s, (time.process_time() - start_cpu_s) / passed_s


def _read(rig: Rig, due_s: float) -> None:
    """Wait for the next hundredth of a second while the rig is served, and read every axis."""
    rig.wait(max(0.0, due_s - time.monotonic()))
    rig.read_states()


def _idle(rig: Rig, _due_s: float) -> None:
    """Serve the rig as during a question to the operator."""
    rig.wait(0.1)
