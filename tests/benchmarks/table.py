"""How much a figure is from, printing of tables, and measurement of a command."""

import os
import resource
import subprocess
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import psutil


def multiply(usual: int) -> int:
    """Return how much a figure is from: as usual, `LABRIG_BENCHMARK_TIMES` times."""
    return usual * int(os.environ.get("LABRIG_BENCHMARK_TIMES", "1"))


def print_rows(heads: Sequence[str], rows: Sequence[Sequence[object]]) -> None:
    """Print rows under their heads in aligned columns."""
    cells = [[str(value) for value in row] for row in (heads, *rows)]
    widths = [max(len(row[column]) for row in cells) for column in range(len(heads))]
    for row in cells:
        print("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip())


@dataclass(frozen=True)
class FinishedCommand:
    """A finished command: wall and processor time, peak memory of all its processes (0 if not asked for), output."""

    wall_s: float
    cpu_s: float
    peak_mb: float
    out: str


def measure(
    command: Sequence[object],
    memory: bool = False,
    environment: Mapping[str, str] | None = None,
    cwd: Path | None = None,
    failures: Sequence[int] = (1,),
) -> FinishedCommand:
    """Run a command, and sample the proportional memory of it and its children twenty times a second if asked for.

    An exit code other than 0 and `failures` (1 means that the answer is no) ends the benchmark with the command's
    standard error.
    """
    words = [str(word) for word in command]
    before_s, began_s = _children_s(), time.perf_counter()
    with (
        ThreadPoolExecutor(1) as pool,
        subprocess.Popen(
            words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment, cwd=cwd
        ) as process,
    ):  # fmt: skip
        peak = pool.submit(_sample_memory, process) if memory else None
        out, stderr = process.communicate()
        wall_s = time.perf_counter() - began_s
        peak_mb = peak.result() / 1e6 if peak else 0.0
    if process.returncode not in {0, *failures}:
        raise RuntimeError(f"{' '.join(words)} ended with {process.returncode}:\n{stderr}")
    return FinishedCommand(wall_s, _children_s() - before_s, peak_mb, out)


def _children_s() -> float:
    """Return the processor time [s] of the processes that were started and have ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _sample_memory(command: "subprocess.Popen[str]") -> int:
    """Return the largest proportional set size of a process and its children, which counts shared pages once."""
    root, largest, ended = psutil.Process(command.pid), 0, False
    while not ended:
        with suppress(psutil.NoSuchProcess, psutil.AccessDenied):  # one ended meanwhile
            family = (root, *root.children(recursive=True))
            largest = max(largest, sum(process.memory_full_info().pss for process in family))
        with suppress(subprocess.TimeoutExpired):
            ended = command.wait(0.05) is not None
    return largest
