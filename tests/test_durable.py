"""Atomic files and disk space."""

import os
from pathlib import Path

import pytest

from labrig.durable import require_free_bytes, temporary_file, write_atomically
from labrig.errors import DiskError
from tests.disks import full_disk


def test_a_file_is_replaced_whole(tmp_path: Path) -> None:
    """Also beside what a killed writer left; a link under the name is replaced, and what it leads to is untouched."""
    path, target, left = (tmp_path / name for name in ("result.json", "precious", ".result.json.01.tmp"))
    target.write_text("kept")
    left.write_bytes(b"half of it")
    path.symlink_to(target)
    for content in (b"old and long", b"new"):
        write_atomically(path, content)
        assert path.read_bytes() == content
    assert target.read_text() == "kept"
    assert {entry.name for entry in tmp_path.iterdir()} == {path.name, target.name, left.name}


def test_a_temporary_file_belongs_to_its_writer(tmp_path: Path) -> None:
    """Two writers of one file have different temporary files, and each removes its own."""
    path = tmp_path / "result.json"
    with temporary_file(path) as first, temporary_file(path) as second:
        assert first != second
        first.write_bytes(b"a")
        second.write_bytes(b"b")
    assert list(tmp_path.iterdir()) == []


def test_a_full_disk_leaves_the_old_file_and_nothing_else(tmp_path: Path) -> None:
    """A file that does not fit replaces nothing, and no part of it is left; a missing folder is named too."""
    path = tmp_path / "result.json"
    write_atomically(path, b"old")
    with full_disk(10_000), pytest.raises(DiskError, match="File too large"):
        write_atomically(path, bytes(100_000))
    assert path.read_bytes() == b"old"
    assert [entry.name for entry in tmp_path.iterdir()] == ["result.json"]
    with pytest.raises(DiskError, match=r"missing/x: No such file or directory$") as refused:
        write_atomically(tmp_path / "missing" / "x", b"")
    assert refused.value.hint


def test_room_is_asked_for_before_a_run(tmp_path: Path) -> None:
    """Enough room passes silently, too little is refused with both numbers, also where no folder is yet."""
    require_free_bytes(tmp_path / "not" / "yet", 1)
    free = os.statvfs(tmp_path).f_bavail * os.statvfs(tmp_path).f_frsize
    with pytest.raises(DiskError, match=r"needs \d+\.\d MB, and that disk has \d+\.\d MB free"):
        require_free_bytes(tmp_path / "not" / "yet", 2 * free)
