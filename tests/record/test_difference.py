"""Comparing two runs."""

from pathlib import Path
from typing import Any

import pytest

from labrig.errors import RecordError
from labrig.record.difference import Difference, compare_runs, group_differences
from labrig.record.json_lines import encode_document
from labrig.record.writer import Recorder
from tests.record.runs import ENDED, PROTOCOL_YAML, STARTED, add_result, closed_run


def test_equal_runs_do_not_differ(tmp_path: Path) -> None:
    """Name, time and command line of a run are no difference."""
    assert compare_runs(closed_run(tmp_path, "a"), closed_run(tmp_path, "b")) == ()


def test_every_section_is_compared(tmp_path: Path) -> None:
    """What was asked, by which code on which devices, and what came out of it is told with both values."""
    versions: dict[str, Any] = {
        "provenance": {"labrig": "0.1.0", "packages": {"numpy": "2.4.6"}, "command_line": ["labrig"]}
    }
    other: dict[str, Any] = {
        "provenance": {"labrig": "0.1.0", "packages": {"numpy": "2.4.5"}, "command_line": ["x"]}
    }
    drive: dict[str, Any] = {"devices": {"axes": {"linear": {"drive": {"software_version": 8464}}}}}
    a = closed_run(tmp_path, "a", **versions, **drive)
    b = closed_run(tmp_path, "b", seed=8, **other)
    (b / "protocol.yaml").write_text((b / "protocol.yaml").read_text().replace("1.2", "1.3"))
    (b / "calibration" / "intrinsics.json").write_text('{"fx": 1.5}')
    for run, radius_mm in ((a, 27.0), (b, 28.0)):
        add_result(run, encode_document({"created": run.name, "specimens": [{"n": 2, "r_mm": radius_mm}]}))
    assert compare_runs(a, b) == (
        Difference("run", "seed", 7, 8),
        Difference("protocol", "needle.diameter_mm", 1.2, 1.3),
        Difference("calibration", "intrinsics.json.fx", 1.0, 1.5),
        Difference("versions", "packages.numpy", "2.4.6", "2.4.5"),
        Difference("devices", "axes.linear.drive.software_version", 8464, None),
        Difference("results", "specimens.0.r_mm", 27.0, 28.0),
    )


def test_code_that_was_changed_otherwise_is_told(tmp_path: Path) -> None:
    """Of one commit, two changed checkouts differ by the hash of what was changed."""
    manifest = {"experiment": "import", "started": STARTED}
    for name in ("a", "b"):
        code_diff = f"changed {name}".encode()
        Recorder.create(tmp_path, name, manifest, PROTOCOL_YAML, None, {}, code_diff=code_diff).close(
            "success", "", ENDED
        )
    (found,) = compare_runs(tmp_path / "a", tmp_path / "b")
    assert (found.section, found.key) == ("versions", "code_diff_sha256")


def test_a_folder_that_is_no_run_is_refused(tmp_path: Path) -> None:
    """Both have to be runs."""
    with pytest.raises(RecordError, match="is no run"):
        compare_runs(closed_run(tmp_path, "a"), tmp_path)


def test_the_differences_of_items_are_summed_up() -> None:
    """How many items of a list differ in a value, and by how much; texts differ by no number."""
    found = [
        Difference("results", "steps.0.nis", 1.0, 2.0),
        Difference("results", "steps.1.nis", 1.0, 4.0),
        Difference("results", "steps.1.reason", None, "lost"),
    ]
    summed = [(group.key, group.count, group.mean, group.largest) for group in group_differences(found)]
    assert summed == [("steps.*.nis", 2, 2.0, 3.0), ("steps.*.reason", 1, None, None)]
