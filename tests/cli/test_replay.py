"""`labrig replay`."""

import shutil
from pathlib import Path

from labrig.record.json_lines import decode_line, encode_line
from tests.cli.conftest import ROOT, Labrig, SweepRun
from tests.cli.cut_runs import open_again


def test_a_sweep_is_identical(sweep: SweepRun, labrig: Labrig) -> None:
    """The replay of a simulated sweep is identical to the last bit; commands, pictures and lines are counted."""
    done = labrig("replay", sweep.run, "--json")
    assert done.exit_code == 0
    document = done.json()
    assert (document["identical"], document["first_difference"], document["bit_exact"]) == (True, None, True)
    assert document["compared"]["frames"] == 40
    assert "identical, to the last bit" in labrig("replay", sweep.run).out


def edit_event(sweep: SweepRun, tmp_path: Path) -> Path:
    """Return the sweep as an open run in which one event states another position than was sent."""
    run = Path(shutil.copytree(sweep.run, tmp_path / "edited"))
    (run / "SHA256SUMS").unlink()
    lines = [decode_line(line) for line in (run / "events.jsonl").read_bytes().splitlines()]
    moved = next(number for number, line in enumerate(lines) if line.get("asked_position") == 40.0)
    lines[moved] = lines[moved] | {"asked_position": 41.0}
    (run / "events.jsonl").write_bytes(b"".join(map(encode_line, lines)))
    open_again(run)
    return run


def test_a_difference_exits_with_1_and_both_values(sweep: SweepRun, labrig: Labrig, tmp_path: Path) -> None:
    """The first difference is printed with the recorded and the new value, its picture and its trial."""
    run = edit_event(sweep, tmp_path)
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
