"""Work at a bench: real commands, drives on a bus of another thread, and a person who types at a terminal."""

import io
import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, redirect_stderr
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TextIO

import pytest

from labrig.devices.clocks import SystemClock
from labrig.devices.opening import Opening
from labrig.devices.rig import open_rig
from labrig.devices.rig_file import load_rig
from labrig.devices.simulated.cia402 import SimulatedCia402Drive
from labrig.experiments.declared import PROTOCOL_MODELS
from labrig.protocol.load import load_protocol
from labrig.protocol.yaml_file import dump_yaml
from labrig.record.events import TrialStart
from labrig.record.reader import open_run
from labrig.record.writer import Recorder, opening_files
from labrig.runner.session import Session
from tests.cli.conftest import RIG, ROOT, SWEEP, Labrig, sweep_command
from tests.devices.rigs import Person, instants
from tests.devices.served import Served, bench_description, served_drives
from tests.small_camera import CALIBRATED_SMALL_CAMERA, set_options

# The drives wait longer than by default for a labrig on a machine that is busy with something else.
PATIENT = ("can.heartbeat.timeout_ms=3000", "can.answer_timeout_ms=2000")
LEAD_MM = 2


@dataclass
class BenchAt:
    """A bench: its drives, its rig file, what its state file says, and the keyboard of the person before it."""

    served: Served
    rig: Path
    keyboard: int
    until_the_end: ExitStack
    answers: list[str] = field(default_factory=list)

    def types(self, *lines: str) -> None:
        """Type a line at each of the next questions, once it is shown."""
        self.answers += lines
        if not isinstance(sys.stderr, Screen):  # not sooner: capsys replaces what a fixture has put there
            self.until_the_end.enter_context(redirect_stderr(Screen(sys.stderr, self)))

    def types_ahead(self, line: str) -> None:
        """Type a line now, before any question."""
        os.write(self.keyboard, f"{line}\n".encode())

    def state(self) -> dict[str, Any]:
        """Return what the rig remembers."""
        document: dict[str, Any] = json.loads((self.rig.parent / "bench.state.json").read_text())
        return document

    def remember(self, **fields: object) -> None:
        """Let the rig remember something."""
        document = {"kind": "labrig-rig-state", "schema_version": 1, "referenced": [], "note": ""}
        document |= {"needle_in_tissue": False, "since_run": None, **fields}
        (self.rig.parent / "bench.state.json").write_text(json.dumps(document))

    def shaft_mm(self, node_id: int) -> float:
        """Return where a shaft truly stands."""
        return self.served.drives[node_id].shaft_counts / (4 * 500 * 4) * LEAD_MM


class Screen(io.StringIO):
    """Standard error as a person reads it, who answers each question."""

    def __init__(self, stream: TextIO, bench: BenchAt) -> None:
        super().__init__()
        self._stream, self._bench = stream, bench

    def write(self, text: str) -> int:
        """Show a text, and answer it if it asks for an answer."""
        self._stream.write(text)
        if "or no to stop" in text and self._bench.answers:
            self._bench.types_ahead(self._bench.answers.pop(0))
        return len(text)


@pytest.fixture
def at_bench(tmp_path: Path) -> Iterator[BenchAt]:
    """Stand at a bench whose gears are known and whose drives have just been switched on."""
    keyboard, screen = os.openpty()
    with served_drives("slcan") as served:
        described = bench_description(served.reached_by, "can.options.sleep_after_open=0", *PATIENT)
        (tmp_path / "bench.yaml").write_text(dump_yaml(described), encoding="utf-8")
        stdin, sys.stdin = sys.stdin, os.fdopen(screen, "r", encoding="utf-8")
        try:
            with ExitStack() as until_the_end:
                yield BenchAt(served, tmp_path / "bench.yaml", keyboard, until_the_end)
        finally:
            sys.stdin.close()
            sys.stdin = stdin
            os.close(keyboard)


def test_an_axis_is_homed_and_jogged(labrig: Labrig, at_bench: BenchAt) -> None:
    """The motor's encoder tells how far it went; the rig file is not written."""
    at_bench.types("yes", "yes")
    done = labrig("devices", "home", "--axis", "linear", "--rig", at_bench.rig)
    assert (done.exit_code, done.out) == (0, "PASS  linear reference: method 35, stands at 0 mm\n")
    assert at_bench.state()["referenced"] == ["linear"]
    at_bench.types("yes")
    before = at_bench.rig.read_bytes()
    done = labrig("devices", "jog", "--axis", "linear", "--distance", 2, "--speed", 5, "--rig", at_bench.rig)
    assert (done.exit_code, done.out[:24]) == (0, "PASS  linear jog: 2 mm a")
    assert at_bench.rig.read_bytes() == before
    assert abs(at_bench.shaft_mm(3) - 2) < 0.02


def test_no_at_the_prompt_moves_nothing(labrig: Labrig, at_bench: BenchAt) -> None:
    """The answer comes before the motion starts, and a yes typed before the question counts for nothing; exit 3."""
    at_bench.remember()
    at_bench.types_ahead("yes")
    at_bench.types("no")
    done = labrig("devices", "jog", "--axis", "insertion", "--rig", at_bench.rig, "--json")
    assert (done.exit_code, done.json()["error"]["type"]) == (3, "SafetyStopError")
    assert at_bench.shaft_mm(1) == 0


def _leave_in_tissue(folder: Path) -> Path:
    """Leave the record of a run that was killed with its needle in tissue, its bevel turned on the way."""
    protocol = load_protocol(SWEEP, PROTOCOL_MODELS)
    manifest = {"experiment": "steerability", "started": "2026-11-20T10:00:00+00:00"}
    recorder = Recorder.create(folder, "killed", manifest, opening_files(dump_yaml(protocol)))
    recorder.event("trial_start", 0.0, trial=0)
    path = ((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.5, 0.0, 1.0), (0.5, 0.5, 1.0), (1.0, 0.5, 1.0))
    for second, place in enumerate(path):
        recorder.state(
            float(second), **dict(zip(("insertion_mm", "rotation_rad", "linear_mm"), place, strict=True))
        )
    return folder / "killed"


def test_a_needle_is_taken_out_after_an_emergency_stop(labrig: Labrig, at_bench: BenchAt) -> None:
    """The fault is reset and the positions are confirmed before the needle comes out."""
    run = _leave_in_tissue(at_bench.rig.parent)
    at_bench.remember(
        needle_in_tissue=True, since_run="killed", referenced=["insertion", "rotation", "linear"]
    )
    refused = labrig("devices", "jog", "--axis", "insertion", "--rig", at_bench.rig)
    way_out = f"labrig devices withdraw --rig {at_bench.rig} --run killed"
    assert (refused.exit_code, way_out in refused.err.replace("\n", " ")) == (3, True)
    drive = at_bench.served.drives[1]
    drive.cut_power_stage()
    drive.restore_power_stage()
    at_bench.types("yes", "yes", "yes", "yes")
    done = labrig("devices", "withdraw", "--run", run, "--rig", at_bench.rig, "--json")
    assert (done.exit_code, done.json()["exit_status"]) == (0, "success")
    told = (
        "0x3220", "have lost their positions", "insertion to 0.5 mm; rotation to 0.0 rad", "Confirm that no",
    )  # fmt: skip
    assert [words for words in told if words not in done.err] == []
    assert (at_bench.state()["needle_in_tissue"], at_bench.state()["referenced"]) == (False, [])
    assert [round(at_bench.shaft_mm(node), 1) for node in (1, 3)] == [-1.0, -1.0]
    assert not any(instants(drive, "homing") for drive in at_bench.served.drives.values())
    record = open_run(done.json()["run"])
    assert record.manifest["withdraws"] == "killed"
    assert (record.path / "can.log").stat().st_size > 0
    again = ("devices", "withdraw", "--rig", at_bench.rig, "--run", run)
    ours = "is the withdrawal of the needle of run killed"
    for words, refusal in (*(((verb, record.path), ours) for verb in ("reanalyze", "replay", "resume")),
                           (again, "no needle is in tissue")):  # fmt: skip
        other = labrig(*words)
        assert (other.exit_code, refusal in other.err) == (2, True), words


CRASH = (
    "import sys, pathlib, tests.cli.test_commissioning as here; here.crash(*map(pathlib.Path, sys.argv[1:]))"
)


def crash(rig_file: Path, runs_dir: Path) -> None:
    """Put a needle into gel, turning its bevel on the way, and be killed."""
    described = load_rig(rig_file)
    ready = Opening(camera=False)
    with open_rig(described, seed=0, person=Person(), interrupted=lambda: None, opening=ready) as rig:
        rig.needle.mark_out()
        rig.reference_axes()
        manifest = {"experiment": "steerability", "started": rig.clock.utc()}
        protocol, text = dump_yaml(load_protocol(SWEEP, PROTOCOL_MODELS)), dump_yaml(described)
        recorder = Recorder.create(runs_dir, "crashed", manifest, opening_files(protocol, text))
        session = Session(rig, recorder, lambda _done, _doing: None)
        session.record(TrialStart(trial=0))
        rig.needle.mark_in_tissue(recorder.run_name)
        path = (
            ("linear", 0.5, 5.0), ("insertion", 0.5, 5.0), ("rotation", 0.3, 1.0), ("insertion", 0.8, 5.0),
        )  # fmt: skip
        for axis, position, speed in path:
            session.move(axis, position, session.axis(axis).nearest_speed(speed))
        rig.axis("insertion").start_move(40.0, 1.0)
        rig.wait(0.3)
        os.kill(os.getpid(), signal.SIGKILL)


def test_a_needle_is_taken_out_after_labrig_was_killed(labrig: Labrig, at_bench: BenchAt) -> None:
    """The drives kept their positions: only the fault and the withdrawal are confirmed."""
    folder = at_bench.rig.parent
    killed = subprocess.run([sys.executable, "-c", CRASH, at_bench.rig, folder], cwd=ROOT, check=False)
    assert killed.returncode == -9
    clock = SystemClock()
    while not all(_in_fault(drive) for drive in at_bench.served.drives.values()) and clock.now_s() < 30:
        clock.sleep(0.05)
    assert at_bench.shaft_mm(1) > 0.9
    at_bench.types("yes", "yes", "yes", "yes")
    left = folder / str(at_bench.state()["since_run"])
    done = labrig("devices", "withdraw", "--run", left, "--rig", at_bench.rig, "--json")
    assert done.exit_code == 0, done.err
    assert done.err.count("0x8130") == 3
    assert "have lost their positions" not in done.err
    assert at_bench.state()["needle_in_tissue"] is False
    assert [round(at_bench.shaft_mm(node), 1) for node in (1, 3)] == [0.0, 0.0]
    assert len(instants(at_bench.served.drives[2], "set-point")) == 2


def _in_fault(drive: SimulatedCia402Drive) -> bool:
    return bool(instants(drive, "emergency")) and not drive.is_moving


def test_an_interrupted_withdrawal_is_continued(
    labrig: Labrig, at_bench: BenchAt, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The needle is not reported out; the next withdrawal starts at the end of the first."""
    run = _leave_in_tissue(at_bench.rig.parent)
    at_bench.remember(needle_in_tissue=True, since_run="killed")
    at_bench.types("yes", "yes", "no")
    monkeypatch.setenv("LABRIG_RUNS_DIR", str(run.parent))
    first = labrig("devices", "withdraw", "--run", run.name, "--rig", at_bench.rig, "--json")
    assert f"labrig devices withdraw --rig {at_bench.rig} --run " in " ".join(first.err.split())
    assert (first.exit_code, first.json()["exit_status"]) == (3, "aborted")
    assert at_bench.state()["needle_in_tissue"] is True
    stood_mm = at_bench.shaft_mm(1)
    wrong = labrig("devices", "withdraw", "--run", run, "--rig", at_bench.rig)
    assert (wrong.exit_code, "not by killed" in wrong.err) == (2, True)
    at_bench.types("yes", "yes", "yes")
    second = labrig("devices", "withdraw", "--rig", at_bench.rig, "--json")
    assert (second.exit_code, at_bench.state()["needle_in_tissue"]) == (0, False)
    assert abs(at_bench.shaft_mm(1) - stood_mm) < 0.02


def test_a_run_of_another_process_is_stopped_by_a_signal(labrig: Labrig, tmp_path: Path) -> None:
    """It stops its axes, closes its record as aborted, exits with 130, and remembers its needle."""
    rig = tmp_path / "rig.yaml"
    text = RIG.read_text(encoding="utf-8").replace("state_file: null ", "state_file: sim.state.json ")
    rig.write_text(text.replace("template: simulated-tip.png", "template: null"), encoding="utf-8")
    command = [*sweep_command(rig, tmp_path), *set_options(*CALIBRATED_SMALL_CAMERA)]
    command += ["--set", "insertions_per_specimen=6"]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True) as running:
        while not _in_tissue(tmp_path / "sim.state.json"):
            assert running.poll() is None
            SystemClock().sleep(0.05)
        refused = labrig("devices", "home", "--rig", rig)
        document = labrig("devices", "stop", "--rig", rig, "--json").json()
        _, talk = running.communicate(timeout=300)
    assert (refused.exit_code, f"process {running.pid}" in refused.err) == (3, True)
    assert "asked labrig run" in document["done"][0]
    assert "it has let go of the rig" in document["done"][0]
    assert running.returncode == 130
    assert "interrupted by SIGTERM" in talk
    assert "nothing is to be taken out" in talk
    (run,) = (path.parent for path in tmp_path.glob("*/manifest.json"))
    assert open_run(run).manifest["exit_status"] == "aborted"


def _in_tissue(state_file: Path) -> bool:
    return state_file.exists() and json.loads(state_file.read_text())["needle_in_tissue"] is True
