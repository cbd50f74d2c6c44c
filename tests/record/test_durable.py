"""Atomic files and disk space."""

import os
from pathlib import Path

import pytest

from labrig.errors import DiskError
from labrig.record.durable import require_free_bytes, write_atomically


def test_a_file_is_replaced_whole(tmp_path: Path) -> None:
    """The new content stands under the name, and no temporary file is left."""
    path = tmp_path / "result.json"
    write_atomically(path, b"old and long")
    write_atomically(path, b"new")
    assert path.read_bytes() == b"new"
    assert [entry.name for entry in tmp_path.iterdir()] == ["result.json"]


def test_a_leftover_of_a_killed_writer_is_no_obstacle(tmp_path: Path) -> None:
    """A temporary file of before is overwritten."""
    (tmp_path / ".result.json.tmp").write_bytes(b"half of it, and longer than the new")
    write_atomically(tmp_path / "result.json", b"new")
    assert [entry.name for entry in tmp_path.iterdir()] == ["result.json"]
    assert (tmp_path / "result.json").read_bytes() == b"new"


def test_no_planted_link_is_written_through(tmp_path: Path) -> None:
    """A link under the temporary name is refused, and what it leads to is untouched."""
    target = tmp_path / "precious"
    target.write_text("kept")
    (tmp_path / ".result.json.tmp").symlink_to(target)
    with pytest.raises(DiskError):
        write_atomically(tmp_path / "result.json", b"new")
    assert target.read_text() == "kept"


def test_a_folder_that_is_not_there_is_named(tmp_path: Path) -> None:
    """The error names the file, the reason and the free space, and has a hint."""
    with pytest.raises(DiskError, match=r"missing/x: No such file.*MB free") as refused:
        write_atomically(tmp_path / "missing" / "x", b"")
    assert refused.value.hint


def test_room_is_asked_for_before_a_run(tmp_path: Path) -> None:
    """Enough room passes silently, too little is refused with both numbers, also where no folder is yet."""
    require_free_bytes(tmp_path / "not" / "yet", 1)
    free = os.statvfs(tmp_path).f_bavail * os.statvfs(tmp_path).f_frsize
    with pytest.raises(DiskError, match=r"needs \d+\.\d MB, and that disk has \d+\.\d MB free"):
        require_free_bytes(tmp_path / "not" / "yet", 2 * free)
