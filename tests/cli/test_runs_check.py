"""`labrig runs check`."""

import json
import shutil
from pathlib import Path

from labrig.record import encode_document
from labrig.record.json_lines import checksum
from tests.cli.conftest import Labrig, Sweep


def left(sweep: Sweep, tmp_path: Path) -> Path:
    """Return the sweep as a power cut would have left it: not closed, its last event torn."""
    run = Path(shutil.copytree(sweep.run, tmp_path / "cut, é"))
    (run / "SHA256SUMS").unlink()
    shutil.rmtree(run / "analysis")
    manifest = (run / "manifest.json").read_text(encoding="utf-8")
    assert '"exit_status": "success"' in manifest
    # The manifest of a run that is still open is that of before: this one is taken back to it.
    document = json.loads(manifest) | {"exit_status": "incomplete", "reason": None, "ended": None}
    del document["crc32"]
    (run / "manifest.json").write_bytes(encode_document({**document, "crc32": checksum(document)}))
    with (run / "events.jsonl").open("r+b") as events:
        events.truncate((run / "events.jsonl").stat().st_size - 9)
    return run


def test_a_finished_run_is_sound(sweep: Sweep, labrig: Labrig) -> None:
    """A run of `labrig run` passes, and says how much it holds."""
    done = labrig("runs", "check", sweep.run, "--json")
    (row,) = done.json()
    assert done.exit_code == 0
    assert (row["ok"], row["damage"], row["torn"], row["trials_done"]) == (True, [], [], 4)
    assert "sound, closed as success" in labrig("runs", "check", sweep.run).out


def test_an_interrupted_run_is_told_and_repaired(sweep: Sweep, labrig: Labrig, tmp_path: Path) -> None:
    """Checking changes nothing and tells what is torn; --repair closes the run, which is then sound and listed so."""
    run = left(sweep, tmp_path)
    before = labrig("runs", "check", run)
    assert before.exit_code == 0
    assert "interrupted; --repair closes it" in before.out
    assert "torn: events.jsonl:" in before.out
    (row,) = labrig("runs", "check", run, "--repair", "--json").json()
    assert (row["ok"], row["repaired"], row["exit_status"], row["torn"]) == (True, True, "aborted", [])
    assert [one["exit_status"] for one in labrig("runs", "--runs-dir", tmp_path, "--json").json()] == [
        "aborted"
    ]


def test_a_damaged_run_exits_with_4_and_what_is_lost(sweep: Sweep, labrig: Labrig, tmp_path: Path) -> None:
    """Each damaged place is named, other runs are checked all the same, and nothing is repaired."""
    run = Path(shutil.copytree(sweep.run, tmp_path / "rotten"))
    content = bytearray((run / "states.jsonl").read_bytes())
    content[100] ^= 1
    (run / "states.jsonl").write_bytes(content)
    (run / "frames" / "000002.png").unlink()
    done = labrig("runs", "check", tmp_path / "nothing", run, sweep.run, "--repair", "--json")
    assert done.exit_code == 4
    nothing, rotten, good = done.json()
    assert [row["ok"] for row in (nothing, rotten, good)] == [False, False, True]
    assert {problem["where"] for problem in rotten["damage"]} == {
        "states.jsonl:1", "states.jsonl", "frames/000002.png",
    }  # fmt: skip
    assert rotten["repaired"] is False
