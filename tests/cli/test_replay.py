"""`labrig replay`."""

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from labrig.record.digest import hash_file
from labrig.record.json_lines import decode_line, encode_line
from tests.cli.conftest import ROOT, Labrig, SweepRun
from tests.cli.cut_runs import open_again


def test_a_sweep_is_identical(sweep: SweepRun, labrig: Labrig) -> None:
    """The replay of a simulated sweep is identical to the last bit; commands, pictures and lines are counted."""
    done = labrig("replay", sweep.run, "--json")
    assert done.exit_code == 0
    document = done.json()
    assert (document["identical"], document["first_difference"], document["bit_exact"]) == (True, None, True)
    assert document["compared"]["frames"] == 24
    assert "identical, to the last bit" in labrig("replay", sweep.run).out


def edit_events(run: Path, change: Callable[[dict[str, Any]], dict[str, Any]]) -> None:
    """Change the events of a run, each with its checksum."""
    lines = [decode_line(line) for line in (run / "events.jsonl").read_bytes().splitlines()]
    (run / "events.jsonl").write_bytes(b"".join(encode_line(change(line)) for line in lines))


def edit_moves(sweep: SweepRun, tmp_path: Path) -> Path:
    """Return the sweep as an open run in which moves state another position than was sent."""
    run = Path(shutil.copytree(sweep.run, tmp_path / "edited"))
    (run / "SHA256SUMS").unlink()
    edit_events(
        run, lambda line: line | {"asked_position": 41.0} if line.get("asked_position") == 40.0 else line
    )
    open_again(run)
    return run


def test_a_difference_exits_with_1_and_both_values(sweep: SweepRun, labrig: Labrig, tmp_path: Path) -> None:
    """The first difference is printed with the recorded and the new value, its picture and its trial."""
    run = edit_moves(sweep, tmp_path)
    done = labrig("replay", run, "--json")
    assert done.exit_code == 1
    document = done.json()
    assert document["identical"] is False
    assert document["first_difference"] | {"t_s": None} == {
        "what": "event", "recorded": "move: asked_position = 41.0", "now": "move: asked_position = 40.0",
        "t_s": None, "frame": 1, "trial": 0,
    }  # fmt: skip
    done = labrig("replay", run)
    assert done.exit_code == 1
    assert "event in the record: move: asked_position = 41.0" in done.out
    assert document["known_change"] is None
    assert "no known change of labrig explains this difference" in done.out


@pytest.mark.parametrize(("off_mm", "known"), [(1e-15, True), (1e-6, False)])
def test_a_difference_by_a_known_change_names_the_changelog(
    labrig: Labrig, tmp_path: Path, off_mm: float, known: bool
) -> None:
    """An older record that differs by a last digit names the change that rounds; by more, it names none."""

    def move(line: dict[str, Any]) -> dict[str, Any]:
        if line["kind"] != "roll_zero_sheath" or line["trial"]:
            return line
        across_mm, along_mm = line["tip_mm"]
        return line | {"tip_mm": [across_mm + off_mm, along_mm]}

    run = Path(shutil.copytree(ROOT / "tests" / "records" / "roll-zero", tmp_path / "roll-zero"))
    sums, before = run / "SHA256SUMS", hash_file(run / "events.jsonl")
    edit_events(run, move)
    sums.write_text(sums.read_text().replace(before, hash_file(run / "events.jsonl")))
    done = labrig("replay", run, "--json")
    change = done.json()["known_change"]
    assert (done.exit_code, done.json()["first_difference"]["what"], change is not None) == (
        1,
        "event",
        known,
    )
    if known:
        assert change["version"] == "0.1.0, unreleased"
        assert change["changelog"].startswith("Linear algebra rounds alike")
        assert "Changelog, 0.1.0, unreleased:" in labrig("replay", run).out


def test_a_record_of_other_code_says_so(labrig: Labrig) -> None:
    """The replay of a record made by older code states where it differs, and which code made it."""
    done = labrig("replay", ROOT / "data" / "first-record")
    assert done.exit_code == 1
    assert "command in the record: no such read so far" in done.out
    assert "other code made this record: labrig 0.1.0, 44a250595045; this is labrig" in done.out


def test_a_damaged_run_is_not_replayed(sweep: SweepRun, labrig: Labrig, tmp_path: Path) -> None:
    """A lost picture, changed CAN frames, and a folder that is no run exit with 4."""
    run = Path(shutil.copytree(sweep.run, tmp_path / "damaged"))
    log = (run / "can.log").read_bytes()
    (run / "can.log").write_bytes(log.replace(b" T\n", b" R\n", 1))
    assert labrig("replay", run).exit_code == 4
    (run / "can.log").write_bytes(log)
    (run / "frames" / "000003.png").unlink()
    assert labrig("replay", run).exit_code == 4
    assert labrig("replay", tmp_path / "none").exit_code == 4
