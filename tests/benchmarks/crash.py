"""SIGKILL at random moments of a run: does the record open, is anything lost, is it repaired, can it resume?

The kills are spread over a sweep, an insertion, a search for the roll zero and a calibration. The first two go on. The
number of kills is LABRIG_BENCHMARK_KILLS, 200 unless set. A process makes one run of each, with imports and backdrop,
and forks the others, which are killed; each returned call of the recorder is acknowledged in a file beside the run.
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
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, fields
from datetime import UTC, datetime
from pathlib import Path
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from labrig.analysis.run import analyze_run
from labrig.devices.rig import open_rig
from labrig.errors import InputError
from labrig.experiments.declared import PROTOCOL_MODELS
from labrig.experiments.registry import find_experiment, find_run_experiment
from labrig.protocol.load import load_protocol
from labrig.protocol.sections import ExperimentProtocol
from labrig.protocol.yaml_file import dump_yaml
from labrig.record.check import check_run
from labrig.record.reader import Run, open_run
from labrig.record.writer import Recorder, opening_files, reopen_run
from labrig.runner.conduct import conduct
from labrig.runner.dry_run import plan_run
from labrig.runner.past import read_past
from labrig.runner.session import Session
from tests.benchmarks.table import print_rows
from tests.cli.example_runs import SHORTENED
from tests.devices.rigs import Person, simulated_rig

KILLS = int(os.environ.get("LABRIG_BENCHMARK_KILLS", "200"))
RUN, ACKNOWLEDGED, UNKILLED = "run", "acknowledged", "unkilled"
NAMES = ("steerability", "insertion", "roll-zero", "calibration")
_PROTOCOLS = Path(__file__).parents[2] / "protocols"
_TWICE = ("insertions_per_specimen=2", "insertion.length_mm=26", "insertion.frame_every_mm=26")
_BATCH = 10
_STARTED = datetime(2026, 3, 2, 9, 30, tzinfo=UTC)
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
    resumed: bool | None = None
    results_equal: bool | None = None

    @property
    def unhurt(self) -> bool:
        """Whether all of it holds."""
        return False not in {getattr(self, each.name) for each in fields(self)}


class _AcknowledgingRecorder(Recorder):
    """A recorder that writes into a file which calls have returned."""

    def acknowledge(self, stream: str) -> None:
        """Acknowledge a recorded line."""
        descriptor = os.open(self.path.parent / ACKNOWLEDGED, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o666)
        os.write(descriptor, f"{stream}\n".encode())
        os.close(descriptor)

    def frame(self, image: NDArray[np.uint8], t_s: float, **fields: object) -> int:
        """Record and acknowledge."""
        number = super().frame(image, t_s, **fields)
        self.acknowledge("frames")
        return number

    def state(self, t_s: float, **fields: object) -> None:
        """Record and acknowledge."""
        super().state(t_s, **fields)
        self.acknowledge("states")

    def event(self, kind: str, t_s: float, **fields: object) -> None:
        """Record and acknowledge."""
        super().event(kind, t_s, **fields)
        self.acknowledge("events")


def _load(name: str) -> ExperimentProtocol:
    """Return a protocol that takes seconds at most."""
    settings = SHORTENED[name] + (_TWICE if name == "steerability" else ())
    return load_protocol(_PROTOCOLS / f"{name}.yaml", PROTOCOL_MODELS, settings)


def _run_once(name: str, folder: Path) -> None:
    """Run a short protocol from opening the rig to closing it."""
    protocol, rig = _load(name), simulated_rig()
    with open_rig(rig, seed=protocol.seed, person=Person(), interrupted=lambda: None) as opened:
        manifest = {
            "experiment": protocol.experiment, "started": opened.clock.utc(), "trials_planned": 2,
            "seed": protocol.seed, "devices": opened.describe(),
        }  # fmt: skip
        files = opening_files(dump_yaml(protocol), dump_yaml(rig), rig.calibration_files())
        recorder = _AcknowledgingRecorder.create(folder, RUN, manifest, files)
        session = Session(opened, recorder, lambda _done, _doing: None)
        conduct(find_experiment(protocol.experiment), protocol, session)


def fork_runs(name: str, unkilled: Path) -> None:
    """Make a run, then fork one for each folder on standard input; print its process id, and its end."""
    _run_once(name, unkilled)
    print("ended", flush=True)
    for line in sys.stdin:
        child = os.fork()
        if child == 0:
            _run_once(name, Path(line.rstrip("\n")))
            os._exit(0)
        print(child, flush=True)
        os.waitpid(child, 0)
        print("ended", flush=True)


def kill_runs(name: str, count: int, seed: int, folder: Path) -> Iterator[Survived]:
    """Kill runs of a protocol at `count` random moments, and yield the state of each."""
    draws, unkilled = random.Random(seed), folder / UNKILLED
    unkilled.mkdir()
    code = f"from tests.benchmarks.crash import fork_runs, Path; fork_runs({name!r}, Path({str(unkilled)!r}))"
    command = [sys.executable, "-c", code]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as forking:
        assert forking.stdout is not None
        assert forking.stdout.readline() == "ended\n"
        reference = open_run(unkilled / RUN)
        radii = _measure_radii(reference) if name == "steerability" else {}
        started = perf_counter()
        _kill_after(forking, folder / "timed", None)
        run_s, number, found = perf_counter() - started, 0, 0
        while found < count:
            number += 1
            if _kill_after(forking, folder / str(number), draws.uniform(0.0, run_s)):
                found += 1
                yield _examine(folder / str(number), name, reference, radii)
        forking.kill()


def _kill_after(forking: subprocess.Popen[str], folder: Path, after_s: float | None) -> bool:
    """Make a run, and kill it after a time; return whether it had begun and not yet ended."""
    folder.mkdir()
    assert forking.stdin is not None
    assert forking.stdout is not None
    print(folder, file=forking.stdin, flush=True)
    child = int(forking.stdout.readline())
    ended = bool(select.select([forking.stdout], [], [], after_s)[0])
    if not ended:
        os.kill(child, signal.SIGKILL)
    assert forking.stdout.readline() == "ended\n"
    return not ended and (folder / RUN / "manifest.json").exists()


def _examine(folder: Path, name: str, reference: Run, radii: Mapping[int, float]) -> Survived:
    """Open a killed run, compare it with an unkilled one, repair a copy of it, and resume it if it can go on."""
    path, acknowledged = folder / RUN, Counter[str]()
    if (folder / ACKNOWLEDGED).exists():
        acknowledged.update((folder / ACKNOWLEDGED).read_text().split())
    run = open_run(path)
    opened = not run.damage and not check_run(path).damage
    lines = {stream: run.lines(stream) for stream in _STREAMS}
    nothing_lost = all(len(lines[stream]) >= acknowledged[stream] for stream in _STREAMS)
    unchanged = all(lines[stream] == reference.lines(stream)[: len(lines[stream])] for stream in _STREAMS)
    repaired = _is_repaired(Path(shutil.copytree(path, folder / "repaired")), lines)
    if name == "steerability":
        return Survived(opened, nothing_lost, unchanged, repaired, *_is_resumed(path, name, radii))
    goes_on = _goes_on(path, name) if name == "insertion" else None
    return Survived(opened, nothing_lost, unchanged, repaired, goes_on)


def _is_repaired(path: Path, lines: Mapping[str, list[dict[str, object]]]) -> bool:
    """Close a copy of a killed run, and return whether it is sound and holds the same lines."""
    if open_run(path).manifest["exit_status"] == "incomplete":  # the kill may have come just after its end
        reopen_run(path, "benchmark").close("aborted", "killed", _STARTED)
    verdict, run = check_run(path), open_run(path)
    same = all(run.lines(stream) == lines[stream] for stream in _STREAMS)
    return same and not verdict.damage and not run.damage and verdict.exit_status != "incomplete"


def _is_resumed(path: Path, name: str, planned: Mapping[int, float]) -> tuple[bool, bool]:
    """Resume a killed sweep; return whether it came to its end, sound, and has the radii of the unkilled one."""
    _resume(path, name)
    again = open_run(path)
    radii = _measure_radii(again)
    finished = [int(trial) for trial in again.trials["trial"][again.trials["exit_status"] == "success"]]
    resumed = again.manifest["exit_status"] == "success" and len(finished) == len(planned)
    same = all(radii[trial] == planned[trial] for trial in finished if trial in planned)
    return resumed and not check_run(path).damage, same and set(finished) <= set(radii)


def _goes_on(path: Path, name: str) -> bool:
    """Resume a killed insertion; return whether it came to an end, sound, or said why it cannot go on."""
    try:
        _resume(path, name)
    except InputError as refusal:
        return bool(refusal.message and refusal.hint)
    return open_run(path).manifest["exit_status"] != "incomplete" and not check_run(path).damage


def _resume(path: Path, name: str) -> None:
    """Resume a killed run as `labrig resume` does; close it if nothing else is left."""
    protocol, run = _load(name), open_run(path)
    if run.manifest["exit_status"] == "success":
        return
    experiment, past = find_run_experiment(run), read_past(run)
    if not plan_run(experiment, protocol, simulated_rig(), past).trials:
        reopen_run(path, "benchmark").close("success", "", _STARTED)
        return
    with open_rig(simulated_rig(), seed=protocol.seed, person=Person(), interrupted=lambda: None) as opened:
        recorder = reopen_run(path, "benchmark")
        recorder.begin_session(opened.clock.utc(), devices=opened.describe())
        conduct(experiment, protocol, Session(opened, recorder, lambda _done, _doing: None), past)


def _measure_radii(run: Run) -> dict[int, float]:
    """Measure a run and return the radius of each trial's final picture."""
    result = analyze_run(run, find_run_experiment(run), created=_STARTED, provenance={}, workers=1)
    return {
        int(line["trial"]): float(line["radius_mm"])
        for line in result.document["measurements"]
        if line["role"] == "final" and line["trial"] is not None and line["radius_mm"] is not None
    }


def print_table() -> None:
    """Print in how many killed runs of each experiment each condition holds."""
    each = KILLS // len(NAMES)
    tasks = [(name, min(_BATCH, each - done), done) for name in NAMES for done in range(0, each, _BATCH)]
    found: dict[str, list[Survived]] = {name: [] for name in NAMES}
    with ProcessPoolExecutor(os.cpu_count()) as pool:
        for (name, *_), survived in zip(tasks, pool.map(_kill_batch, *zip(*tasks, strict=True)), strict=True):
            found[name] += survived
    rows = [
        [field.name.replace("_", " "), *(_count(runs, field.name) for runs in found.values()), each]
        for field in fields(Survived)
    ]
    print_rows((f"{each} kills at random moments of each", *NAMES, "limit"), rows)


def _count(runs: list[Survived], condition: str) -> int | str:
    answers = [getattr(survived, condition) for survived in runs]
    return "-" if None in answers else sum(answers)


def _kill_batch(name: str, count: int, seed: int) -> list[Survived]:
    """Kill some runs in a folder and a process of their own."""
    with tempfile.TemporaryDirectory() as folder:
        return list(kill_runs(name, count, seed, Path(folder)))
