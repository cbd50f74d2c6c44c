"""The memory of a process that gives so many tasks of 1 ms to two others; a part of the benchmark `engine`.

`python -m tests.benchmarks.engine_memory TASKS` prints the resident memory before the first task, its peak [MB], and
the peak of what Python has allocated since [kB].
"""

import re
import sys
import tracemalloc
from pathlib import Path
from threading import Event

from labrig.analysis.engine import open_process_pool, run_in_order
from labrig.devices.clocks import SystemClock


def wait_short(_: int) -> None:
    """Take 1 ms, not of the processor."""
    Event().wait(0.001)


def print_memory(tasks: int) -> None:
    """Give the tasks to two workers, forget what they came to, and print the memory."""
    with open_process_pool(2, "waited") as pool:
        before_mb = _peak_mb()
        tracemalloc.start()
        for _ in run_in_order(pool, wait_short, iter(range(tasks)), clock=SystemClock()):
            pass
        print(f"{before_mb:.1f} {_peak_mb():.1f} {tracemalloc.get_traced_memory()[1] / 1e3:.0f}")


def _peak_mb() -> float:
    """Return the peak of this program; `getrusage` has that of the program that started it too."""
    (line,) = re.findall(r"VmHWM:\s+(\d+) kB", Path("/proc/self/status").read_text(encoding="ascii"))
    return int(line) / 1e3


if __name__ == "__main__":
    print_memory(int(sys.argv[1]))
