"""The folder of an export: nothing is replaced unasked, and nothing half-written stays."""

from pathlib import Path

import pytest

from labrig.errors import OutputExistsError, RecordError
from labrig.record.output_folder import copy_record, output_folder
from labrig.record.reader import open_run
from tests.record.runs import closed_run


def test_a_copy_of_a_record_is_a_run(tmp_path: Path) -> None:
    """It opens whole; links and hidden files are not in it."""
    run = closed_run(tmp_path, "one")
    (run / ".hidden").write_text("mine")
    (run / "link").symlink_to(tmp_path)
    with output_folder(tmp_path / "copy", force=False) as folder:
        copy_record(run, folder)
    assert open_run(tmp_path / "copy").damage == ()
    assert {".hidden", "link"}.isdisjoint(path.name for path in (tmp_path / "copy").iterdir())


def test_nothing_there_is_replaced_unasked(tmp_path: Path) -> None:
    """A folder that exists is refused; forced, its files are replaced and others stay. A file is always refused."""
    out = tmp_path / "out"
    with output_folder(out, force=False) as folder:
        (folder / "a.csv").write_text("1")
        (folder / "b.csv").write_text("1")
    with pytest.raises(OutputExistsError, match="exists already"), output_folder(out, force=False):
        pass
    with output_folder(out, force=True) as folder:
        (folder / "a.csv").write_text("2")
    assert [(out / name).read_text() for name in ("a.csv", "b.csv")] == ["2", "1"]
    with pytest.raises(OutputExistsError, match="is a file"), output_folder(out / "a.csv", force=True):
        pass


def test_a_link_in_the_place_of_an_export_is_not_followed(tmp_path: Path) -> None:
    """A link to a folder or file within an existing export is replaced, and nothing is written where it leads."""
    out, elsewhere = tmp_path / "out", tmp_path / "elsewhere"
    out.mkdir()
    elsewhere.mkdir()
    (elsewhere / "a.csv").write_text("mine")
    (out / "frames").symlink_to(elsewhere)
    (out / "a.csv").symlink_to(elsewhere / "a.csv")
    with output_folder(out, force=True) as folder:
        (folder / "frames").mkdir()
        (folder / "frames" / "1.png").write_text("1")
        (folder / "a.csv").write_text("2")
    assert {path.name: path.read_text() for path in elsewhere.iterdir()} == {"a.csv": "mine"}
    assert (out / "frames" / "1.png").read_text() == "1"
    assert (out / "a.csv").read_text() == "2"


def test_an_export_that_fails_leaves_nothing(tmp_path: Path) -> None:
    """Files are put in their place when all of them are whole."""
    with pytest.raises(RecordError, match="a picture is damaged"):
        _fail_to_write(tmp_path / "out")
    assert list(tmp_path.iterdir()) == []


def _fail_to_write(out: Path) -> None:
    with output_folder(out, force=False) as folder:
        (folder / "a.csv").write_text("1")
        raise RecordError("a picture is damaged")
