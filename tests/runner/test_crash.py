"""SIGKILL in the middle of a run: nothing that was recorded is lost, the record can be closed, and the run goes on.

What a kill inside a call of the recorder leaves is tried in `tests/record/test_crash.py`.
"""

import math
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from labrig.analysis.run import analyze_run
from labrig.devices.rig import open_rig
from labrig.experiments.declared import PROTOCOL_MODELS, find_experiment
from labrig.experiments.registry import find_run_experiment
from labrig.protocol.load import load_protocol
from labrig.protocol.sections import ExperimentProtocol
from labrig.record.check import check_run
from labrig.record.reader import Run, open_run
from labrig.record.writer import Recorder, reopen_run
from labrig.runner.conduct import conduct
from labrig.runner.dry_run import plan_run
from labrig.runner.past import read_past
from labrig.runner.session import Session
from tests.cli.example_runs import SHORTENED
from tests.devices.rigs import Person, simulated_rig
from tests.record.runs import ENDED
from tests.runner.sessions import files_of

_PROTOCOLS = Path(__file__).parents[2] / "protocols"
_TWICE = ("insertions_per_specimen=2", "insertion.length_mm=26", "insertion.frame_every_mm=26")
_STREAMS = ("states", "events", "frames")
SHARES = (0.05, 0.2, 0.4, 0.6, 0.8, 0.98)


class _KilledRecorder(Recorder):
    """A recorder that kills its process when so many lines are recorded."""

    left = math.inf

    def _count(self) -> None:
        self.left -= 1
        if self.left <= 0:
            os.kill(os.getpid(), signal.SIGKILL)

    def frame(self, image: NDArray[np.uint8], t_s: float, **fields: object) -> int:
        """Record and count."""
        number = super().frame(image, t_s, **fields)
        self._count()
        return number

    def state(self, t_s: float, **fields: object) -> None:
        """Record and count."""
        super().state(t_s, **fields)
        self._count()

    def event(self, kind: str, t_s: float, **fields: object) -> None:
        """Record and count."""
        super().event(kind, t_s, **fields)
        self._count()


def _load(name: str) -> ExperimentProtocol:
    """Return a protocol that takes seconds at most."""
    settings = SHORTENED[name] + (_TWICE if name == "steerability" else ())
    return load_protocol(_PROTOCOLS / f"{name}.yaml", PROTOCOL_MODELS, settings)


def _record(name: str, runs_dir: Path, most_lines: float = math.inf) -> None:
    """Run a short protocol, from opening the rig to closing it, unless it is killed before."""
    protocol, rig = _load(name), simulated_rig()
    with open_rig(rig, seed=protocol.seed, person=Person(), interrupted=lambda: None) as opened:
        manifest = {
            "experiment": protocol.experiment, "started": opened.clock.utc(), "trials_planned": 2,
            "seed": protocol.seed, "devices": opened.describe(),
        }  # fmt: skip
        recorder = _KilledRecorder.create(runs_dir, "run", manifest, files_of(protocol, rig))
        recorder.left = most_lines
        session = Session(opened, recorder, lambda _done, _doing: None)
        conduct(find_experiment(protocol.experiment), protocol, session)


def record_killed(name: str, folder: Path, shares: tuple[float, ...]) -> None:
    """Make a whole run in `folder/whole`, and one for each share of its lines that is killed when it has so many."""
    _record(name, folder / "whole")
    count = sum(len(open_run(folder / "whole" / "run").lines(stream)) for stream in _STREAMS)
    for share in shares:
        most = max(1, int(share * count))
        if os.fork() == 0:
            _record(name, folder / str(most), most)
            os._exit(1)
        assert os.WTERMSIG(os.wait()[1]) == signal.SIGKILL


def _measure_radii(run: Run) -> dict[int, float]:
    """Measure a run and return the radius of each trial's final picture."""
    result = analyze_run(run, find_run_experiment(run), created=ENDED, provenance={}, workers=1)
    rows = result.document["measurements"]
    return {row["trial"]: row["radius_mm"] for row in rows if row["role"] == "final"}


def _resume(path: Path, name: str) -> None:
    """Resume a killed run as `labrig resume` does; close it if nothing else is left."""
    protocol, run = _load(name), open_run(path)
    experiment, past = find_run_experiment(run), read_past(run)
    recorder = reopen_run(path, "test")
    if not plan_run(experiment, protocol, simulated_rig(), past).trials:
        recorder.close("success", "", ENDED)
        return
    with open_rig(simulated_rig(), seed=protocol.seed, person=Person(), interrupted=lambda: None) as opened:
        recorder.begin_session(opened.clock.utc(), devices=opened.describe())
        conduct(experiment, protocol, Session(opened, recorder, lambda _done, _doing: None), past)


KILLED = {
    "steerability": SHARES, "insertion": SHARES[1::2], "roll-zero": SHARES[1:3], "calibration": SHARES[1:3],
}  # fmt: skip


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with runs of each protocol, made in a process without threads, which can fork."""
    folder = tmp_path_factory.mktemp("killed")
    code = (
        "from tests.runner.test_crash import *\n"
        f"for name, shares in KILLED.items(): record_killed(name, Path({str(folder)!r}) / name, shares)"
    )
    subprocess.run([sys.executable, "-c", code], check=True, cwd=_PROTOCOLS.parent)
    return folder


@pytest.mark.parametrize("name", KILLED)
def test_a_killed_run_loses_nothing_is_repaired_and_goes_on(name: str, recorded: Path) -> None:
    """Every recorded line is there and unchanged; closed it is sound; a resumed sweep has the radii of a whole one."""
    whole = open_run(recorded / name / "whole" / "run")
    planned = _measure_radii(whole) if name == "steerability" else {}
    killed = sorted(int(path.name) for path in (recorded / name).iterdir() if path.name.isdigit())
    assert len(killed) == len(KILLED[name])
    for count in killed:
        path = recorded / name / str(count) / "run"
        run = open_run(path)
        lines = {stream: run.lines(stream) for stream in _STREAMS}
        assert (run.damage, check_run(path).damage) == ((), ())
        assert sum(map(len, lines.values())) == count
        assert all(found == whole.lines(stream)[: len(found)] for stream, found in lines.items())
        repaired = Path(shutil.copytree(path, path.with_name("repaired")))
        reopen_run(repaired, "test").close("aborted", "killed", ENDED)
        assert (check_run(repaired).damage, check_run(repaired).exit_status) == ((), "aborted")
        assert {stream: open_run(repaired).lines(stream) for stream in _STREAMS} == lines
        if name == "steerability":
            _resume(path, name)
            assert (check_run(path).damage, check_run(path).exit_status) == ((), "success")
            trials = open_run(path).trials
            finished = trials["trial"][trials["exit_status"] == "success"].tolist()
            radii = _measure_radii(open_run(path))
            # An insertion that was cut is made anew in another hole, as a further trial.
            assert len(finished) == len(planned)
            assert {trial: radii[trial] for trial in finished if trial in planned}.items() <= planned.items()
            assert set(finished) <= set(radii)
