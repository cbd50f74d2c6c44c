"""A record of each experiment, made by `python -m tests.records` and kept under tests/records."""

import json
import shutil
from pathlib import Path

import pytest

from labrig.record.json_lines import encode_line, read_lines
from tests.cli.conftest import ROOT, Labrig
from tests.cli.cut_runs import open_again

KEPT = ROOT / "tests" / "records"
NAMES = sorted(path.name for path in KEPT.iterdir() if path.is_dir())
AGREES = ("identical", "equivalent")


@pytest.fixture(params=NAMES)
def kept(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """Return a writable copy of a kept record."""
    return Path(shutil.copytree(KEPT / request.param, tmp_path / request.param))


def test_one_of_each_experiment_is_kept() -> None:
    """Every experiment has a kept record."""
    experiments = {
        json.loads((KEPT / name / "manifest.json").read_text(encoding="utf-8"))["experiment"]
        for name in NAMES
    }
    assert experiments >= {
        "steerability", "insertion", "roll-zero", "camera-calibration", "design", "import",
    }  # fmt: skip


def test_together_they_are_small() -> None:
    """The kept records are small enough for a checkout."""
    assert sum(path.stat().st_size for path in KEPT.rglob("*") if path.is_file()) < 2_200_000


def test_a_kept_record_is_sound(kept: Path, labrig: Labrig) -> None:
    """Every file of a kept record passes its checksums."""
    (row,) = labrig("runs", "check", kept, "--json").json()
    assert (row["ok"], row["damage"], row["notices"], row["exit_status"]) == (True, [], [], "success")


@pytest.mark.processors
def test_a_kept_record_is_measured_as_before(kept: Path, labrig: Labrig) -> None:
    """A reanalysis gives every number of the kept result, on any processor within its tolerance."""
    done = labrig("reanalyze", kept, "--json")
    (row,) = done.json()
    assert (done.exit_code, row["ok"], Path(row["analysis"]).name) == (0, True, "002")
    assert row["verdict"] in AGREES, row["first_difference"]


@pytest.mark.processors
def test_a_kept_record_replays(kept: Path, labrig: Labrig) -> None:
    """The procedure decides the same again; no procedure made imported pictures."""
    done = labrig("replay", kept, "--json")
    if kept.name == "import":
        assert done.exit_code == 2
    else:
        replay = done.json()
        assert (done.exit_code, replay["first_difference"]) == (0, None)
        assert replay["verdict"] in AGREES


@pytest.mark.processors
@pytest.mark.parametrize("name", ["insertion", "roll-zero", "steerability", "camera-calibration"])
def test_a_decision_that_was_altered_by_hand_is_different(tmp_path: Path, labrig: Labrig, name: str) -> None:
    """Whatever the processor: one word of one question is not what the procedure says."""
    run = Path(shutil.copytree(KEPT / name, tmp_path / name))
    events = run / "events.jsonl"
    lines = read_lines(events)
    number = next(n for n, line in enumerate(lines) if line["kind"] == "operator" and line["details"])
    details = dict(lines[number]["details"])
    key = next(iter(details))
    lines[number] |= {"details": details | {key: f"{details[key]} other"}}
    events.write_bytes(b"".join(map(encode_line, lines)))
    open_again(run)
    done = labrig("replay", run, "--json")
    replay = done.json()
    assert (done.exit_code, replay["verdict"]) == (1, "different")
    assert replay["first_difference"]["path"] == f"operator.details.{key}"
