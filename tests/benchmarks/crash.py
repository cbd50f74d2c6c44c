"""SIGKILL at random moments of a sweep: does the record open, is anything lost, and can the sweep resume?"""

import os
import random
import select
import shutil
import signal
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import dataclass, fields
from datetime import UTC, datetime
from pathlib import Path
from time import perf_counter

from labrig.analysis.run import analyze_run
from labrig.devices.rig import open_rig
from labrig.experiments.registry import experiment_of
from labrig.record.check import check_run
from labrig.record.reader import Run, open_run
from labrig.record.writer import Recorder
from labrig.runner.conduct import conduct_remainder
from labrig.runner.session import Session
from tests.benchmarks.crashing import ACKNOWLEDGED, RUN, UNKILLED, never, rig, short_sweep
from tests.benchmarks.table import print_rows
from tests.devices.rigs import Person

MOMENTS = 200
_BATCH = 10
_STARTED = datetime(2026, 3, 2, 9, 30, tzinfo=UTC)
_STREAMS = ("states", "events", "frames")


@dataclass(frozen=True)
class Survived:
    """The state of a run after a SIGKILL."""

    opened: bool
    nothing_lost: bool
    lines_unchanged: bool
    resumed: bool
    results_equal: bool


_UNHURT = Survived(opened=True, nothing_lost=True, lines_unchanged=True, resumed=True, results_equal=True)


class SweepSource:
    """A process that forks sweeps to be killed.

    Attributes
    ----------
    sweep_s : float
        Duration of a whole sweep.
    reference : Run
        A sweep that was not killed.
    radii : dict
        Its results: trial to radius [mm].
    """

    def __init__(self, process: subprocess.Popen[str], folder: Path) -> None:
        self._process = process
        self._folder = folder
        self._numbers = iter(range(1_000_000))
        assert process.stdout is not None
        assert process.stdout.readline() == "ended\n"
        self.reference = open_run(folder / UNKILLED / RUN)
        self.radii = measure_radii(self.reference)
        started = perf_counter()
        self.kill_after(None)
        self.sweep_s = perf_counter() - started

    def kill_after(self, after_s: float | None) -> Path | None:
        """Return the folder of a sweep killed after a time; None if it had not begun or had already ended."""
        folder = self._folder / str(next(self._numbers))
        folder.mkdir()
        process = self._process
        assert process.stdin is not None
        assert process.stdout is not None
        process.stdin.write(f"{folder}\n")
        process.stdin.flush()
        child = int(process.stdout.readline())
        ended = bool(select.select([process.stdout], [], [], after_s)[0])
        if not ended:
            os.kill(child, signal.SIGKILL)
        assert process.stdout.readline() == "ended\n"
        return None if ended or not (folder / RUN / "manifest.json").exists() else folder


@contextmanager
def fork_sweeps(folder: Path) -> Iterator[SweepSource]:
    """Start the process that forks sweeps."""
    (folder / UNKILLED).mkdir()
    command = [sys.executable, "-m", "tests.benchmarks.crashing", str(folder / UNKILLED)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        yield SweepSource(process, folder)
        process.kill()


def kill_sweeps(count: int, seed: int, folder: Path) -> Iterator[Survived]:
    """Kill sweeps at `count` random moments, and yield the state of each run."""
    source = random.Random(seed)
    with fork_sweeps(folder) as source_of_runs:
        found = 0
        while found < count:
            killed = source_of_runs.kill_after(source.uniform(0.0, source_of_runs.sweep_s))
            if killed is not None:
                found += 1
                yield examine_killed(killed, source_of_runs)
                shutil.rmtree(killed)


def examine_killed(folder: Path, unkilled: SweepSource) -> Survived:
    """Open the run of a killed sweep, compare it with an unkilled sweep, and resume it."""
    path = folder / RUN
    acknowledged = (
        Counter((folder / ACKNOWLEDGED).read_text().split())
        if (folder / ACKNOWLEDGED).exists()
        else Counter()
    )
    run = open_run(path)
    opened = not run.damage and not check_run(path).damage
    lines = {stream: run.lines(stream) for stream in _STREAMS}
    nothing_lost = all(len(lines[stream]) >= acknowledged[stream] for stream in _STREAMS)
    theirs = {stream: unkilled.reference.lines(stream) for stream in _STREAMS}
    unchanged = all(lines[stream] == theirs[stream][: len(lines[stream])] for stream in _STREAMS)
    _resume(path)
    again = open_run(path)
    planned, radii = unkilled.radii, measure_radii(again)
    finished = [int(trial) for trial in again.trials["trial"][again.trials["exit_status"] == "success"]]
    resumed = again.manifest["exit_status"] == "success" and len(finished) == len(planned)
    same = all(radii[trial] == planned[trial] for trial in finished if trial in planned)
    sound = resumed and not check_run(path).damage
    return Survived(opened, nothing_lost, unchanged, sound, same and set(finished) <= set(radii))


def _resume(path: Path) -> None:
    """Resume a killed run as `labrig resume` does; close it if nothing else is left."""
    protocol, run = short_sweep(), open_run(path)
    if run.manifest["exit_status"] == "success":
        return
    sweep_experiment = experiment_of(run)
    remainder = sweep_experiment.resume(protocol, run)
    if not remainder.left:
        recorder = Recorder.reopen(path, "benchmark")
        recorder.close("success", "", _STARTED)
        return
    with open_rig(rig(), seed=protocol.seed, person=Person(), interrupted=never) as opened:
        recorder = Recorder.reopen(path, "benchmark")
        recorder.begin_session(opened.clock.utc(), devices=opened.describe())
        conduct_remainder(sweep_experiment, remainder, Session(opened, recorder, lambda _done, _doing: None))


def measure_radii(run: Run) -> dict[int, float]:
    """Measure a run and return the radius of each trial's final picture."""
    result = analyze_run(run, experiment_of(run), created=_STARTED, provenance={}, workers=1)
    return {
        int(line["trial"]): float(line["radius_mm"])
        for line in result.document["measurements"]
        if line["role"] == "final" and line["trial"] is not None and line["radius_mm"] is not None
    }


def print_table(count: int = MOMENTS) -> None:
    """Print in how many killed sweeps each condition holds; progress goes to standard error."""
    found: list[Survived] = []
    started = perf_counter()
    sizes = [min(_BATCH, count - done) for done in range(0, count, _BATCH)]
    with ProcessPoolExecutor(os.cpu_count()) as pool:
        batches = [pool.submit(_kill_batch, size, seed) for seed, size in enumerate(sizes)]
        for batch in as_completed(batches):
            found += batch.result()
            sound = sum(survived == _UNHURT for survived in found)
            print(
                f"{len(found)} of {count} killed, {sound} sound, {perf_counter() - started:.0f} s",
                file=sys.stderr,
                flush=True,
            )
    rows = [
        [
            field.name.replace("_", " "),
            sum(getattr(survived, field.name) for survived in found),
            f"{count} of {count}",
        ]
        for field in fields(Survived)
    ]
    print_rows(("after SIGKILL at a random moment", "runs", "limit"), rows)


def _kill_batch(count: int, seed: int) -> list[Survived]:
    """Kill some sweeps in a folder and a process of their own."""
    with tempfile.TemporaryDirectory() as folder:
        return list(kill_sweeps(count, seed, Path(folder)))


if __name__ == "__main__":
    print_table(int(sys.argv[1]) if len(sys.argv) > 1 else MOMENTS)
