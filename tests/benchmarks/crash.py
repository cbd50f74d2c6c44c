"""SIGKILL at random moments of a run: does the record open, is anything lost, is it repaired, can it resume?

The kills are spread over a sweep, an insertion, a search for the roll zero and a calibration. The first two go on.
"""

import os
import random
import select
import shutil
import signal
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import dataclass, fields
from datetime import UTC, datetime
from functools import cached_property
from pathlib import Path
from time import perf_counter

from labrig.analysis.run import analyze_run
from labrig.devices.rig import open_rig
from labrig.errors import InputError
from labrig.experiments.registry import find_run_experiment
from labrig.record.check import check_run
from labrig.record.reader import Run, open_run
from labrig.record.writer import reopen_run
from labrig.runner.conduct import conduct_remainder
from labrig.runner.dry_run import plan_run
from labrig.runner.past import read_past
from labrig.runner.session import Session
from tests.benchmarks.crashing import ACKNOWLEDGED, RUN, SHORT, UNKILLED, never, rig, short_protocol
from tests.benchmarks.table import print_rows
from tests.devices.rigs import Person

MOMENTS = 200
_BATCH = 10
_STARTED = datetime(2026, 3, 2, 9, 30, tzinfo=UTC)
_SWEEP, _INSERTION = "steerability", "insertion"
_STREAMS = ("states", "events", "frames")


@dataclass(frozen=True)
class Survived:
    """The state of a run after a SIGKILL; None for what is not tried.

    A resumed sweep gives the radii of the unkilled one; an insertion is made again in another block.
    """

    opened: bool
    nothing_lost: bool
    lines_unchanged: bool
    repaired: bool
    resumed: bool | None
    results_equal: bool | None

    @property
    def unhurt(self) -> bool:
        """Whether all of it holds."""
        return False not in {getattr(self, each.name) for each in fields(self)}


class RunSource:
    """A process that forks runs of a short protocol to be killed.

    Attributes
    ----------
    name : str
        The protocol.
    run_s : float
        Duration of a whole run.
    reference : Run
        A run that was not killed.
    """

    def __init__(self, name: str, process: subprocess.Popen[str], folder: Path) -> None:
        self.name = name
        self._process = process
        self._folder = folder
        self._numbers = iter(range(1_000_000))
        assert process.stdout is not None
        assert process.stdout.readline() == "ended\n"
        self.reference = open_run(folder / UNKILLED / RUN)
        started = perf_counter()
        self.kill_after(None)
        self.run_s = perf_counter() - started

    @cached_property
    def radii(self) -> dict[int, float]:
        """The results of the sweep that was not killed: trial to radius [mm]."""
        return measure_radii(self.reference)

    def kill_after(self, after_s: float | None) -> Path | None:
        """Return the folder of a run killed after a time; None if it had not begun or had already ended."""
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
def fork_runs(name: str, folder: Path) -> Iterator[RunSource]:
    """Start the process that forks runs."""
    (folder / UNKILLED).mkdir()
    command = [sys.executable, "-m", "tests.benchmarks.crashing", name, str(folder / UNKILLED)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        yield RunSource(name, process, folder)
        process.kill()


def kill_runs(name: str, count: int, seed: int, folder: Path) -> Iterator[Survived]:
    """Kill runs of a protocol at `count` random moments, and yield the state of each."""
    source = random.Random(seed)
    with fork_runs(name, folder) as source_of_runs:
        found = 0
        while found < count:
            killed = source_of_runs.kill_after(source.uniform(0.0, source_of_runs.run_s))
            if killed is not None:
                found += 1
                yield examine_killed(killed, source_of_runs)
                shutil.rmtree(killed)


def examine_killed(folder: Path, unkilled: RunSource) -> Survived:
    """Open a killed run, compare it with an unkilled one, repair a copy of it, and resume it if it is a sweep."""
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
    repaired = _is_repaired(Path(shutil.copytree(path, folder / "repaired")), lines)
    if unkilled.name == _SWEEP:
        return Survived(opened, nothing_lost, unchanged, repaired, *_is_resumed(path, unkilled))
    if unkilled.name == _INSERTION:
        return Survived(opened, nothing_lost, unchanged, repaired, _goes_on(path), None)
    return Survived(opened, nothing_lost, unchanged, repaired, None, None)


def _is_repaired(path: Path, lines: Mapping[str, list[dict[str, object]]]) -> bool:
    """Close a copy of a killed run, and return whether it is sound and holds the same lines."""
    if open_run(path).manifest["exit_status"] == "incomplete":  # the kill may have come just after its end
        reopen_run(path, "benchmark").close("aborted", "killed", _STARTED)
    verdict, run = check_run(path), open_run(path)
    same = all(run.lines(stream) == lines[stream] for stream in _STREAMS)
    return same and not verdict.damage and not run.damage and verdict.exit_status != "incomplete"


def _is_resumed(path: Path, unkilled: RunSource) -> tuple[bool, bool]:
    """Resume a killed run; return whether it came to its end, sound, and has the results of the unkilled one."""
    _resume(path, unkilled.name)
    again = open_run(path)
    planned, radii = unkilled.radii, measure_radii(again)
    finished = [int(trial) for trial in again.trials["trial"][again.trials["exit_status"] == "success"]]
    resumed = again.manifest["exit_status"] == "success" and len(finished) == len(planned)
    same = all(radii[trial] == planned[trial] for trial in finished if trial in planned)
    return resumed and not check_run(path).damage, same and set(finished) <= set(radii)


def _goes_on(path: Path) -> bool:
    """Resume a killed insertion; return whether it came to an end, sound, or said why it cannot go on."""
    try:
        _resume(path, _INSERTION)
    except InputError as refusal:
        return bool(refusal.message and refusal.hint)
    return open_run(path).manifest["exit_status"] != "incomplete" and not check_run(path).damage


def _resume(path: Path, name: str) -> None:
    """Resume a killed run as `labrig resume` does; close it if nothing else is left."""
    protocol, run = short_protocol(name), open_run(path)
    if run.manifest["exit_status"] == "success":
        return
    experiment = find_run_experiment(run)
    past = read_past(run)
    if not plan_run(experiment, protocol, rig(), past).trials:
        recorder = reopen_run(path, "benchmark")
        recorder.close("success", "", _STARTED)
        return
    with open_rig(rig(), seed=protocol.seed, person=Person(), interrupted=never) as opened:
        recorder = reopen_run(path, "benchmark")
        recorder.begin_session(opened.clock.utc(), devices=opened.describe())
        session = Session(opened, recorder, lambda _done, _doing: None)
        conduct_remainder(experiment, protocol, past, session)


def measure_radii(run: Run) -> dict[int, float]:
    """Measure a run and return the radius of each trial's final picture."""
    result = analyze_run(run, find_run_experiment(run), created=_STARTED, provenance={}, workers=1)
    return {
        int(line["trial"]): float(line["radius_mm"])
        for line in result.document["measurements"]
        if line["role"] == "final" and line["trial"] is not None and line["radius_mm"] is not None
    }


def print_table(count: int = MOMENTS) -> None:
    """Print in how many killed runs of each experiment each condition holds; progress goes to standard error."""
    found: dict[str, list[Survived]] = {name: [] for name in SHORT}
    started = perf_counter()
    each = count // len(SHORT)
    with ProcessPoolExecutor(os.cpu_count()) as pool:
        batches = {
            pool.submit(_kill_batch, name, min(_BATCH, each - done), done): name
            for name in SHORT
            for done in range(0, each, _BATCH)
        }
        for batch in as_completed(batches):
            found[batches[batch]] += batch.result()
            killed = [survived for runs in found.values() for survived in runs]
            sound = sum(survived.unhurt for survived in killed)
            print(
                f"{len(killed)} of {each * len(SHORT)} killed, {sound} unhurt, {perf_counter() - started:.0f} s",
                file=sys.stderr,
                flush=True,
            )
    rows = [
        [field.name.replace("_", " "), *(_count(runs, field.name) for runs in found.values()), each]
        for field in fields(Survived)
    ]
    print_rows((f"{each} kills at random moments of each", *found, "limit"), rows)


def _count(runs: list[Survived], condition: str) -> int | str:
    answers = [getattr(survived, condition) for survived in runs]
    return "-" if None in answers else sum(answers)


def _kill_batch(name: str, count: int, seed: int) -> list[Survived]:
    """Kill some runs in a folder and a process of their own."""
    with tempfile.TemporaryDirectory() as folder:
        return list(kill_runs(name, count, seed, Path(folder)))


if __name__ == "__main__":
    print_table(int(sys.argv[1]) if len(sys.argv) > 1 else MOMENTS)
