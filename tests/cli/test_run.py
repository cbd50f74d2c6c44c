"""`labrig run` from the protocol to the report, on the simulated rig."""

import json
import os
import signal
import subprocess
from pathlib import Path

import pytest

from tests.cli.conftest import RIG, SMALL_RIG, SMALL_SWEEP, SWEEP, Labrig, SweepRun, sweep_command


def _lines(path: Path) -> list[dict[str, object]]:
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]


def test_a_sweep_succeeds_and_states_a_radius_for_each_gel(sweep: SweepRun) -> None:
    """The JSON document names the run, its report and each gel's mean radius, SD, n and interval."""
    assert sweep.document["exit_status"] == "success"
    assert Path(sweep.document["report"]).is_file()
    specimens = sweep.document["result"]["specimens"]
    assert [specimen["n"] for specimen in specimens] == [2, 2]
    for specimen in specimens:
        low, high = specimen["ci95_mm"]
        assert low < specimen["mean_radius_mm"] < high


def test_the_same_seed_gives_the_same_bytes(sweep: SweepRun, labrig: Labrig, tmp_path: Path) -> None:
    """The same protocol, rig and seed give the same frames, states and events, byte for byte."""
    again = labrig("run", SWEEP, "--runs-dir", tmp_path, "--json", *SMALL_SWEEP)
    run = Path(again.json()["run"])
    for name in ("states.jsonl", "events.jsonl", "frames.jsonl", "truth.jsonl", "can.log"):
        assert (run / name).read_bytes() == (sweep.run / name).read_bytes(), name
    assert {path.name: path.read_bytes() for path in (run / "frames").iterdir()} == {
        path.name: path.read_bytes() for path in (sweep.run / "frames").iterdir()
    }


def test_another_seed_gives_other_radii(sweep: SweepRun, labrig: Labrig, tmp_path: Path) -> None:
    """--seed changes the draws of the simulated world, and is recorded."""
    short = ("insertions_per_specimen=1", "specimens=[{name: gel-10, gelatin_percent: 10}]")
    settings = (*SMALL_SWEEP, *(word for setting in short for word in ("--set", setting)))
    done = labrig("run", SWEEP, "--runs-dir", tmp_path, "--json", "--seed", 7, *settings)
    run = Path(done.json()["run"])
    assert _lines(run / "truth.jsonl")[0]["radius_mm"] != _lines(sweep.run / "truth.jsonl")[0]["radius_mm"]
    assert json.loads((run / "manifest.json").read_text())["seed"] == 7


@pytest.mark.parametrize("name", ["INT", "TERM", "HUP"])
def test_a_signal_stops_the_run_and_closes_its_record(name: str, tmp_path: Path) -> None:
    """INT, TERM and HUP stop the axes of a background run, close its record as aborted, and exit with 130."""
    number = getattr(signal, f"SIG{name}")
    command = [*sweep_command(RIG, tmp_path), *SMALL_RIG]
    started = subprocess.Popen(
        ["sh", "-c", 'trap "" INT HUP; exec "$@"', "sh", *command],
        stderr=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        env={**os.environ, "PYTHONUNBUFFERED": "1"},
    )
    assert started.stderr is not None
    assert b"%" in started.stderr.readline()
    started.send_signal(number)
    _, err = started.communicate(timeout=60)
    assert started.returncode == 130
    assert b"Traceback" not in err
    (run,) = tmp_path.iterdir()
    manifest = json.loads((run / "manifest.json").read_text())
    assert manifest["exit_status"] == "aborted"
    assert name in manifest["reason"]
    assert _lines(run / "events.jsonl")[-1]["kind"] == "run_stop"
