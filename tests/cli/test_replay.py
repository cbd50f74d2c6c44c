"""`labrig replay`."""

import json
import shutil
from collections.abc import Callable
from hashlib import sha256
from pathlib import Path
from typing import Any

import pytest

from labrig.record.json_lines import decode_line, encode_line
from labrig.record.layout import encode_sums, read_sums
from tests.cli.conftest import ROOT, Labrig, SweepRun
from tests.cli.cut_runs import open_again


def edit_events(run: Path, change: Callable[[dict[str, Any]], dict[str, Any]]) -> None:
    """Change the events of a run, each with its checksum."""
    lines = [decode_line(line) for line in (run / "events.jsonl").read_bytes().splitlines()]
    (run / "events.jsonl").write_bytes(b"".join(encode_line(change(line)) for line in lines))


def edit_moves(sweep: SweepRun, tmp_path: Path) -> Path:
    """Return the sweep as an open run in which moves state another position than was sent."""
    run = Path(shutil.copytree(sweep.run, tmp_path / "edited"))
    edit_events(
        run, lambda line: line | {"asked_position": 23.0} if line.get("asked_position") == 22.0 else line
    )
    open_again(run)
    return run


def test_a_difference_exits_with_1_and_both_values(sweep: SweepRun, labrig: Labrig, tmp_path: Path) -> None:
    """The first difference is printed with the recorded and the new value, its picture and its trial."""
    run = edit_moves(sweep, tmp_path)
    done = labrig("replay", run, "--json")
    assert done.exit_code == 1
    document = done.json()
    assert (document["verdict"], document["identical"]) == ("different", False)
    assert document["first_difference"] | {"t_s": None} == {
        "path": "move.insertion_mm", "recorded": 23.0, "now": 22.0, "size": 1.0, "tolerance": 0.0025,
        "t_s": None, "frame": 1, "trial": 0, "went_on": True,
    }  # fmt: skip
    done = labrig("replay", run)
    assert done.exit_code == 1
    assert "in the record: 23.0" in done.out
    assert "they differ by 1; 0.0025 is allowed" in done.out


@pytest.mark.parametrize(("off_mm", "verdict", "code"), [(1e-6, "equivalent", 0), (0.02, "different", 1)])
def test_a_number_within_its_tolerance_is_equivalent(
    labrig: Labrig, tmp_path: Path, off_mm: float, verdict: str, code: int
) -> None:
    """A place that a processor rounds otherwise is no other decision; the largest difference is told."""

    def move(line: dict[str, Any]) -> dict[str, Any]:
        if line["kind"] != "roll_zero_sheath" or line["trial"]:
            return line
        across_mm, along_mm = line["tip_mm"]
        return line | {"tip_mm": [across_mm + off_mm, along_mm]}

    run = Path(shutil.copytree(ROOT / "tests" / "records" / "roll-zero", tmp_path / "roll-zero"))
    edit_events(run, move)
    open_again(run)
    done = labrig("replay", run, "--json")
    document = done.json()
    assert (done.exit_code, document["verdict"]) == (code, verdict)
    assert document["largest"]["roll_zero_sheath.tip_mm.*"] == pytest.approx(off_mm, abs=1e-3 * off_mm + 1e-7)


def _forget_an_answer(run: Path) -> None:
    def forget(line: dict[str, Any]) -> dict[str, Any]:
        return {key: value for key, value in line.items() if key != "confirmed"}

    edit_events(run, forget)


def _enlarge_calibration(run: Path) -> None:
    path = run / "calibration" / "intrinsics.json"
    lens = json.loads(path.read_text(encoding="utf-8"))
    path.write_text(json.dumps(lens | {"image_size": [704, 448]}), encoding="utf-8")
    sums = {**read_sums(run), "calibration/intrinsics.json": sha256(path.read_bytes()).hexdigest()}
    (run / "SHA256SUMS").write_bytes(encode_sums(sums))


@pytest.mark.parametrize(
    ("command", "spoil", "reason"),
    [
        ("replay", _forget_an_answer, "confirmed"),
        ("replay", _enlarge_calibration, "704x448"),
        ("reanalyze", _enlarge_calibration, "intrinsics"),
    ],
)
def test_a_record_that_cannot_be_used_says_why(
    tmp_path: Path, labrig: Labrig, command: str, spoil: Callable[[Path], None], reason: str
) -> None:
    """A lost answer and a calibration of other pictures; nothing is written."""
    run = Path(shutil.copytree(ROOT / "tests" / "records" / "roll-zero", tmp_path / "roll-zero"))
    open_again(run)
    spoil(run)
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    done = labrig(command, run, "--json")
    assert done.exit_code in {2, 4}, done.out
    assert reason in done.out
    assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == before
