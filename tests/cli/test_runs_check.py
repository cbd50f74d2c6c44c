"""`labrig runs check`."""

import inspect
import shutil
from pathlib import Path

from labrig.cli.runs import app
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


def test_a_root_that_was_written_down_is_compared(sweep: SweepRun, labrig: Labrig, tmp_path: Path) -> None:
    """What was added after it is listed; a root that the chain does not hold ends with 4, a mistyped one with 2."""
    run = Path(shutil.copytree(sweep.run, tmp_path / "run"))
    root = str(sweep.document["root"])
    assert labrig("runs", "note", run, "later", "--by", "Ada").exit_code == 0
    done = labrig("runs", "check", run, "--root", f" {root[:16].upper()} ", "--json")
    (row,) = done.json()
    assert (done.exit_code, row["ok"], row["root"], row["seal"]) == (0, True, root, "sealed")
    assert [link["kind"] for link in row["after_root"]] == ["result", "page", "note"]
    assert root in labrig("runs", "check", run).out
    assert root in (run / "report.html").read_text(encoding="utf-8")
    (gone,) = labrig("runs", "check", run, "--root", "0" * 64, "--json").json()
    assert (gone["ok"], gone["damage"][-1]["where"]) == (False, "chain.jsonl")
    assert labrig("runs", "check", run, "--root", "0" * 64).exit_code == 4
    for mistyped in ("123", "x" * 16):
        assert labrig("runs", "check", run, "--root", mistyped).exit_code == 2
    assert labrig("runs", "check", run, run, "--root", root).exit_code == 2


def test_a_group_of_commands_serves_any_number_of_command_lines(sweep: SweepRun, labrig: Labrig) -> None:
    """What is put around its commands is put there once in a process."""
    for _ in range(3):
        assert labrig("runs", "check", sweep.run).exit_code == 0
    for info in app.registered_commands:
        assert inspect.unwrap(info.callback or app) is getattr(info.callback, "__wrapped__", None)
