"""Whatever is changed, lost or added in a run is named, and nothing changed is used silently."""

import json
import os
import shutil
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from labrig.errors import LabrigError
from labrig.record.check import check_run
from labrig.record.reader import Run, open_run
from labrig.record.results import finish_result
from tests.record.runs import add_result, begin, closed_run, fill, killed_run

CHANGES = int(os.environ.get("LABRIG_CHANGES", "60"))
"""Random changes that are tried; more for a figure."""


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a closed run with every kind of file, and two results."""
    run = closed_run(tmp_path_factory.mktemp("whole"))
    for number in range(2):
        folder = add_result(run, json.dumps({"value": number, "list": list(range(50))}).encode())
        (folder / "SHA256SUMS").unlink()
        (folder / "measurements.csv").write_text("radius_mm\n27.5\n")
        finish_result(folder)
    return run


def list_files(run: Path) -> list[str]:
    """Return every file that a check covers."""
    files = (path for path in run.rglob("*") if path.is_file() and not path.name.startswith("."))
    return sorted(path.relative_to(run).as_posix() for path in files)


def read_all(run: Run) -> list[object]:
    """Return everything that a run says; what it refuses is raised."""
    tables = (run.states, run.events, run.truth, run.frame_table, run.trials, run.measurements)
    files = (run.protocol_path, run.rig_path, *map(run.calibration_path, run.calibration_files))
    return [
        run.manifest,
        run.result,
        run.devices,
        *(table.to_json() for table in tables),
        *(file.read_bytes() for file in files if file is not None),
        *(picture.tobytes() for picture in run.pictures),
        *((run.result_dir(number) / "result.json").read_bytes() for number in run.result_numbers),
    ]


def is_named(run: Path, file: str) -> bool:
    """Return whether a check names a file, also by refusing the run."""
    try:
        found = check_run(run)
    except LabrigError as error:
        return file in error.message
    return any(
        problem.where.partition(":")[0] == file or Path(file).name in problem.message
        for problem in (*found.damage, *found.notices)
    )


def is_used_silently(run: Path, before: list[object]) -> bool:
    """Return whether a changed run says something else than before without a word."""
    try:
        opened = open_run(run)
        return not opened.damage and read_all(opened) != before
    except LabrigError:
        return False


@settings(max_examples=CHANGES, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_a_changed_byte_is_named_and_not_used_silently(whole: Path, data: st.DataObject) -> None:
    """Any byte of any file of a closed run."""
    file = data.draw(st.sampled_from(list_files(whole)))
    path = whole / file
    content = path.read_bytes()
    place = data.draw(st.integers(0, len(content) - 1))
    other = data.draw(st.integers(1, 255))
    before = read_all(open_run(whole))
    path.write_bytes(content[:place] + bytes([content[place] ^ other]) + content[place + 1 :])
    try:
        assert is_named(whole, file), (file, place, other)
        assert not is_used_silently(whole, before), (file, place, other)
    finally:
        path.write_bytes(content)


def test_a_lost_file_is_named(whole: Path, tmp_path: Path) -> None:
    """Each file of a closed run, by `runs check` and when it is opened or read."""
    before = read_all(open_run(whole))
    for file in list_files(whole):
        run = Path(shutil.copytree(whole, tmp_path / "copy"))
        (run / file).unlink()
        if file.endswith("/SHA256SUMS"):  # a result without its sums is one that was never finished
            assert check_run(run).notices
        else:
            assert is_named(run, file), file
        if not file.startswith("analysis/"):
            assert not is_used_silently(run, before), file
        shutil.rmtree(run)


@pytest.mark.parametrize(
    "file", ["Thumbs.db", "frames/000099.png", "calibration/mask.png", "analysis/001/extra.csv", "can.log.1"]
)
def test_an_added_file_is_named_and_not_used(tmp_path: Path, file: str) -> None:
    """What is no part of the record is no damage of it; in a result it is."""
    run = closed_run(tmp_path)
    add_result(run, b"{}")
    before = read_all(open_run(run))
    (run / file).write_bytes(b"x")
    assert is_named(run, file)
    assert not is_used_silently(run, before)
    assert bool(check_run(run).damage) == file.startswith("analysis/")


def test_nothing_is_read_through_a_link_or_out_of_the_run(tmp_path: Path) -> None:
    """A file that is a link is refused, and so is a name in SHA256SUMS that is no file of the run."""
    run = closed_run(tmp_path)
    with (run / "SHA256SUMS").open("a") as sums:
        sums.write(f"{'0' * 64}  ../secret\n")
    assert [problem.where for problem in check_run(run).damage] == ["SHA256SUMS"]
    run = closed_run(tmp_path, "linked")
    (run / "states.jsonl").rename(tmp_path / "elsewhere")
    (run / "states.jsonl").symlink_to(tmp_path / "elsewhere")
    (problem,) = check_run(run).damage
    assert (problem.where, "symbolic link" in problem.message) == ("states.jsonl", True)


def test_what_a_run_began_with_is_covered_before_it_ends(tmp_path: Path) -> None:
    """Protocol, rig and calibration, and each picture by its line; files that nothing covers yet are no strangers."""
    recorder = begin(tmp_path)
    fill(recorder)
    found = check_run(recorder.path)
    assert (found.damage, found.notices, found.writer is None) == ((), (), False)
    assert (found.holds["frames"], found.holds["trials_done"]) == (4, 2)
    for file in ("protocol.yaml", "rig.yaml", "calibration/plane.json", "frames/000001.png", "states.jsonl"):
        run = killed_run(tmp_path / file.replace("/", "-"))
        assert check_run(run).damage == ()
        (run / file).write_bytes(b"other\n")
        assert [problem.where for problem in check_run(run).damage] == [file]
