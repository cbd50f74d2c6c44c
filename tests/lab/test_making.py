"""How a lab folder is made, and how one of an older labrig is brought up to date."""

from collections.abc import Mapping
from pathlib import Path

import pytest

from labrig.errors import DiskError, InputError, OutputExistsError
from labrig.lab.folder import MARKER, RIG_SCHEMA, RUNS
from labrig.lab.making import SCHEMAS, Written, list_lab_files, make_lab_folder, update_lab_folder
from tests.disks import full_disk

SCHEMA = SCHEMAS[0]
OLD = list_lab_files({"protocols/a.yaml": b"old a", "protocols/b.yaml": b"old b", SCHEMA: b"old schema"})
NEW = {**OLD, "protocols/a.yaml": b"new a", "protocols/c.yaml": b"new c", SCHEMA: b"new schema"}


def _contents(folder: Path, files: Mapping[str, bytes]) -> dict[str, bytes]:
    return {place: (folder / place).read_bytes() for place in files if (folder / place).exists()}


def test_a_lab_folder_is_made(tmp_path: Path) -> None:
    """It holds the examples, what git and an editor read, and a folder for the runs."""
    made = make_lab_folder(tmp_path / "lab", OLD, "1.0")
    assert made == Written(added=tuple(OLD))
    assert _contents(tmp_path / "lab", OLD) == OLD
    assert (tmp_path / "lab" / RUNS).is_dir()
    assert b"/data/runs/" in OLD[".gitignore"]


def test_hidden_files_are_kept(tmp_path: Path) -> None:
    """A folder with a repository or an environment may become a lab folder; its own .gitignore stays."""
    (tmp_path / ".gitignore").write_bytes(b"mine")
    assert make_lab_folder(tmp_path, OLD, "1.0").kept == (".gitignore",)
    assert (tmp_path / ".gitignore").read_bytes() == b"mine"


def test_an_update_replaces_what_nobody_has_changed(tmp_path: Path) -> None:
    """New and missing files are added; a changed example is kept, and named if labrig has another version of it."""
    make_lab_folder(tmp_path, OLD, "1.0")
    assert update_lab_folder(tmp_path, NEW, "1.1") == Written(
        added=("protocols/c.yaml",), replaced=("protocols/a.yaml", SCHEMA)
    )
    assert _contents(tmp_path, NEW) == NEW
    (tmp_path / "protocols/a.yaml").write_bytes(b"my a")
    (tmp_path / "protocols/b.yaml").unlink()
    (tmp_path / "protocols/c.yaml").write_bytes(b"my c")
    newer = {**NEW, "protocols/a.yaml": b"newer a"}
    assert update_lab_folder(tmp_path, newer, "1.2") == Written(
        added=("protocols/b.yaml",), kept=("protocols/a.yaml",)
    )
    assert (tmp_path / "protocols/a.yaml").read_bytes() == b"my a"
    assert (tmp_path / "protocols/c.yaml").read_bytes() == b"my c"


def test_a_lab_folder_without_a_marker_loses_nothing(tmp_path: Path) -> None:
    """One that was copied from a checkout is marked; of its files only the schemas are replaced."""
    make_lab_folder(tmp_path, OLD, "1.0")
    (tmp_path / MARKER).unlink()
    (tmp_path / "calibration").mkdir()
    (tmp_path / RIG_SCHEMA).write_bytes(b"schema of rigs")
    assert update_lab_folder(tmp_path, NEW, "1.1").kept == ("protocols/a.yaml",)
    assert (tmp_path / "protocols/a.yaml").read_bytes() == b"old a"
    assert (tmp_path / MARKER).is_file()


def test_a_disk_that_is_full_leaves_a_lab_folder_that_an_update_completes(tmp_path: Path) -> None:
    """What could not be written is added later."""
    large = {**OLD, "protocols/large.yaml": b"x" * 100_000}
    with full_disk(50_000), pytest.raises(DiskError, match=r"large\.yaml"):
        make_lab_folder(tmp_path / "lab", large, "1.0")
    with pytest.raises(OutputExistsError, match=r"is a lab folder already, made by labrig 1\.0"):
        make_lab_folder(tmp_path / "lab", large, "1.0")
    update_lab_folder(tmp_path / "lab", large, "1.0")
    assert _contents(tmp_path / "lab", large) == large


def test_an_update_that_was_cut_short_is_completed(tmp_path: Path) -> None:
    """The old marker stays until the end, so that no example of labrig's own is taken for a changed one."""
    make_lab_folder(tmp_path, OLD, "1.0")
    large = {**NEW, SCHEMA: b"x" * 100_000}
    with full_disk(50_000), pytest.raises(DiskError):
        update_lab_folder(tmp_path, large, "1.1")
    assert update_lab_folder(tmp_path, large, "1.1").kept == ()
    assert _contents(tmp_path, large) == large


def test_a_folder_with_other_files_is_refused(tmp_path: Path) -> None:
    """So is a file, and an update of a folder that is no lab's; each says what to do."""
    (tmp_path / "thesis.tex").touch()
    with pytest.raises(OutputExistsError, match=r"holds other files: thesis\.tex") as refused:
        make_lab_folder(tmp_path, OLD, "1.0")
    assert refused.value.hint == f"name a new folder: labrig init {tmp_path / 'lab'}"
    with pytest.raises(OutputExistsError, match="is a file"):
        make_lab_folder(tmp_path / "thesis.tex", OLD, "1.0")
    with pytest.raises(InputError, match="is not a lab folder"):
        update_lab_folder(tmp_path, OLD, "1.0")
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.tex"]


@pytest.mark.parametrize("made_by", ["2.0", "1.0rc1"])
def test_a_lab_folder_of_a_newer_labrig_is_left_alone(tmp_path: Path, made_by: str) -> None:
    """Neither command changes it; both say which labrig it needs."""
    make_lab_folder(tmp_path, NEW, made_by)
    for change in (make_lab_folder, update_lab_folder):
        with pytest.raises(InputError, match=f"labrig {made_by}, which is newer than this labrig 0.9"):
            change(tmp_path, OLD, "0.9")
    assert _contents(tmp_path, NEW) == NEW


@pytest.mark.parametrize(
    "marker",
    [b"", b"{", b"[]", b'{"format": 1, "labrig": "soon", "files": {}}', b'{"format": 1, "labrig": "1"}'],
)
def test_a_damaged_marker_is_named(tmp_path: Path, marker: bytes) -> None:
    """It is not guessed which examples were changed; nothing is written."""
    make_lab_folder(tmp_path, OLD, "1.0")
    (tmp_path / MARKER).write_bytes(marker)
    with pytest.raises(InputError, match="is damaged") as refused:
        update_lab_folder(tmp_path, NEW, "1.1")
    assert refused.value.hint.startswith("move it away, then: labrig init --update")
    assert _contents(tmp_path, OLD) == OLD


def test_a_marker_of_a_later_format_is_of_a_newer_labrig(tmp_path: Path) -> None:
    """Whatever its files look like then."""
    make_lab_folder(tmp_path, OLD, "1.0")
    (tmp_path / MARKER).write_bytes(b'{"format": 2, "labrig": "1.0", "files": []}')
    with pytest.raises(InputError, match=r"newer than this labrig 1\.1"):
        update_lab_folder(tmp_path, NEW, "1.1")
