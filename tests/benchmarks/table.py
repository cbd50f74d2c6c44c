"""Printing of tables, and measurement of a command."""

import subprocess
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass

import psutil


def print_rows(heads: Sequence[str], rows: Sequence[Sequence[object]]) -> None:
    """Print rows under their heads in aligned columns."""
    cells = [[str(value) for value in row] for row in (heads, *rows)]
    widths = [max(len(row[column]) for row in cells) for column in range(len(heads))]
    for row in cells:
        print("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip())


@dataclass(frozen=True)
class FinishedCommand:
    """A finished command: wall time, peak memory of all its processes, exit code and output."""

    wall_s: float
    peak_mb: float
    exit_code: int
    out: str


def measure(command: Sequence[str]) -> FinishedCommand:
    """Run a command and sample the proportional memory of it and its children twenty times a second.

    An exit code above 1 (1 means that the answer is no) ends the benchmark with the standard error of the command.
    """
    # The output goes into a file: an unread pipe would fill up while the memory is sampled, and block the command.
    with (
        tempfile.TemporaryFile("w+", encoding="utf-8") as out,
        tempfile.TemporaryFile("w+", encoding="utf-8") as stderr,
    ):
        started = time.perf_counter()
        process = subprocess.Popen(command, stdout=out, stderr=stderr)
        root = psutil.Process(process.pid)
        peak = 0
        while _still_runs(process):
            peak = max(peak, _memory(root))
        wall_s = time.perf_counter() - started
        out.seek(0)
        stderr.seek(0)
        if process.returncode not in {0, 1}:
            raise RuntimeError(f"{' '.join(command)} ended with {process.returncode}:\n{stderr.read()}")
        return FinishedCommand(wall_s, peak / 1e6, process.returncode, out.read())


def _still_runs(process: subprocess.Popen[bytes]) -> bool:
    """Wait for a twentieth of a second and return whether the process still runs."""
    try:
        process.wait(timeout=0.05)
    except subprocess.TimeoutExpired:
        return True
    return False


def _memory(root: psutil.Process) -> int:
    """Return the proportional set size of a process and its children, which counts shared pages once."""
    total = 0
    try:
        for process in (root, *root.children(recursive=True)):
            total += process.memory_full_info().pss
    except (psutil.NoSuchProcess, psutil.AccessDenied):
        return total
    return total
