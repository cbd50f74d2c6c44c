"""`labrig runs check`."""

import shutil
from pathlib import Path

from tests.cli.conftest import Labrig, SweepRun
from tests.cli.cut_runs import cut_short


def test_a_finished_run_is_sound(sweep: SweepRun, labrig: Labrig) -> None:
    """A run of `labrig run` passes, and its contents are counted."""
    done = labrig("runs", "check", sweep.run, "--json")
    (row,) = done.json()
    assert done.exit_code == 0
    assert (row["ok"], row["damage"], row["torn"], row["trials_done"]) == (True, [], [], 4)
    assert "sound, closed as success" in labrig("runs", "check", sweep.run).out


def test_an_interrupted_run_is_told_and_repaired(sweep: SweepRun, labrig: Labrig, tmp_path: Path) -> None:
    """A check names torn ends and changes nothing; --repair closes the run, which then passes."""
    run = cut_short(sweep.run, tmp_path / "cut, é", 30.0)
    before = labrig("runs", "check", run)
    assert before.exit_code == 0
    assert "interrupted; --repair closes it" in before.out
    assert "torn: events.jsonl:" in before.out
    (row,) = labrig("runs", "check", run, "--repair", "--json").json()
    assert (row["ok"], row["repaired"], row["exit_status"], row["torn"]) == (True, True, "aborted", [])
    assert [row["exit_status"] for row in labrig("runs", "--runs-dir", tmp_path, "--json").json()] == [
        "aborted"
    ]


def test_a_damaged_run_exits_with_4_and_what_is_lost(sweep: SweepRun, labrig: Labrig, tmp_path: Path) -> None:
    """Each damaged place is named, other runs are still checked, and nothing is repaired."""
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
