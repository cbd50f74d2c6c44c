"""`labrig run` from the protocol to the report, on the simulated rig."""

import hashlib
import json
import os
import signal
import subprocess
from pathlib import Path

import pytest

from tests.cli.conftest import RIG, SHORT_SWEEP, SWEEP, Labrig, SweepRun, sweep_command


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


def test_the_measured_radii_are_the_drawn_ones(sweep: SweepRun) -> None:
    """Each picture's radius lies within 0.25 mm of the radius that the world drew for that insertion."""
    drawn = {line["trial"]: line["radius_mm"] for line in _lines(sweep.run / "truth.jsonl")}
    measured = {
        row["trial"]: row["radius_mm"]
        for row in sweep.document["result"]["measurements"]
        if row["role"] == "final" and row["accepted"]
    }
    assert set(measured) == set(drawn)
    assert [trial for trial in drawn if abs(measured[trial] - drawn[trial]) > 0.25] == []


def test_every_insertion_leaves_its_pictures(sweep: SweepRun) -> None:
    """An insertion of 40 mm has pictures of the hole, the sheath, every 10 mm, and the final shape."""
    roles = [line["role"] for line in _lines(sweep.run / "frames.jsonl") if line["trial"] == 0]
    assert roles == ["hole", "sheath", *["advance"] * 3, "final"]


def test_the_closed_record_is_covered_by_checksums(sweep: SweepRun) -> None:
    """SHA256SUMS lists every raw file of the run with its hash."""
    lines = [line.split("  ", 1) for line in (sweep.run / "SHA256SUMS").read_text().splitlines()]
    listed = {file: digest for digest, file in lines}
    raw = {"protocol.yaml", "rig.yaml", "frames.jsonl", "states.jsonl", "events.jsonl", "truth.jsonl"}
    assert raw <= set(listed)
    for name, digest in listed.items():
        assert hashlib.sha256((sweep.run / name).read_bytes()).hexdigest() == digest


def test_the_same_seed_gives_the_same_bytes(sweep: SweepRun, labrig: Labrig, tmp_path: Path) -> None:
    """The same protocol, rig and seed give the same frames, states and events, byte for byte."""
    again = labrig("run", SWEEP, "--rig", RIG, "--runs-dir", tmp_path, "--json", *SHORT_SWEEP)
    run = Path(again.json()["run"])
    for name in ("states.jsonl", "events.jsonl", "frames.jsonl", "truth.jsonl", "can.log"):
        assert (run / name).read_bytes() == (sweep.run / name).read_bytes(), name
    assert {path.name: path.read_bytes() for path in (run / "frames").iterdir()} == {
        path.name: path.read_bytes() for path in (sweep.run / "frames").iterdir()
    }


def test_another_seed_gives_other_radii(sweep: SweepRun, labrig: Labrig, tmp_path: Path) -> None:
    """--seed changes the draws of the simulated world, and is recorded."""
    shortened = (
        *SHORT_SWEEP,
        "--set",
        "insertions_per_specimen=1",
        "--set",
        "specimens=[{name: gel-10, gelatin_percent: 10}]",
    )
    run = Path(
        labrig("run", SWEEP, "--rig", RIG, "--runs-dir", tmp_path, "--json", "--seed", 7, *shortened).json()[
            "run"
        ]
    )
    assert _lines(run / "truth.jsonl")[0]["radius_mm"] != _lines(sweep.run / "truth.jsonl")[0]["radius_mm"]
    assert json.loads((run / "manifest.json").read_text())["seed"] == 7


def test_an_existing_run_is_never_overwritten(labrig: Labrig, tmp_path: Path) -> None:
    """A run name that exists is refused with exit code 2, and the existing run is unchanged."""
    taken = tmp_path / "taken"
    taken.mkdir()
    (taken / "precious").write_text("data")
    done = labrig("run", SWEEP, "--rig", RIG, "--runs-dir", tmp_path, "--run-name", "taken", "--json")
    assert done.exit_code == 2
    assert done.json()["error"]["type"] == "OutputExistsError"
    assert [path.name for path in taken.iterdir()] == ["precious"]


def test_a_move_beyond_the_limits_is_refused_before_anything_moves(labrig: Labrig, tmp_path: Path) -> None:
    """An insertion longer than the axis is named with its limit, and no run is made."""
    done = labrig("run", SWEEP, "--rig", RIG, "--runs-dir", tmp_path, "--set", "insertion.length_mm=4000",
                  "--set", "specimen_width_mm=20000")  # fmt: skip
    assert done.exit_code == 2
    assert "4000" in done.err
    assert list(tmp_path.iterdir()) == []


def test_an_unreachable_bus_is_one_clear_error(labrig: Labrig, tmp_path: Path) -> None:
    """A missing CAN interface exits with 3, names the channel, and leaves no run."""
    rig = tmp_path / "rig.yaml"
    rig.write_text(RIG.read_text().replace("interface: simulated", "interface: socketcan"), encoding="utf-8")
    done = labrig("run", SWEEP, "--rig", rig, "--runs-dir", tmp_path / "runs", "--json")
    assert done.exit_code in {2, 3}
    assert "Traceback" not in done.err


@pytest.mark.parametrize("name", ["INT", "TERM", "HUP"])
def test_a_signal_stops_the_run_and_closes_its_record(name: str, tmp_path: Path) -> None:
    """INT, TERM and HUP stop the axes of a background run, close its record as aborted, and exit with 130."""
    number = getattr(signal, f"SIG{name}")
    command = sweep_command(RIG, tmp_path)
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
