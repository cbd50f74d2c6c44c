"""Which folder is a lab's, where runs go, and how a lab folder is made."""

from pathlib import Path

import pytest

from labrig.errors import DiskError, OutputExistsError
from labrig.lab import (
    PROTOCOL_SCHEMA,
    RIG_SCHEMA,
    RUNS,
    RUNS_DIR_VARIABLE,
    choose_runs_dir,
    find_lab_folder,
    make_lab_folder,
    read_examples,
)
from tests.disks import full_disk

ROOT = Path(__file__).parents[1]
SCHEMAS = (PROTOCOL_SCHEMA.as_posix(), RIG_SCHEMA.as_posix())
FILES = {"protocols/a.yaml": b"a", "protocols/b.yaml": b"b", **dict.fromkeys(SCHEMAS, b"schema")}


def test_runs_go_where_the_nearest_of_four_says(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In this order: --runs-dir, LABRIG_RUNS_DIR, the lab folder upwards, the working folder."""
    make_lab_folder(tmp_path / "lab", FILES)
    monkeypatch.chdir(tmp_path / "lab" / "protocols")
    monkeypatch.setenv(RUNS_DIR_VARIABLE, "/other/runs")
    assert choose_runs_dir(Path("here")).path == Path("here")
    assert choose_runs_dir().path == Path("/other/runs")
    monkeypatch.setenv(RUNS_DIR_VARIABLE, "")
    assert choose_runs_dir().path == Path("..") / RUNS
    assert choose_runs_dir().reason == f"in the lab folder {tmp_path / 'lab'}"
    monkeypatch.chdir(tmp_path)
    assert choose_runs_dir().path == RUNS


def test_the_nearest_lab_folder_counts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One inside another is a lab of its own; a checkout is one; a working folder that is gone is in none."""
    make_lab_folder(tmp_path / "lab", FILES)
    (tmp_path / "lab" / "pilot").mkdir()
    monkeypatch.chdir(tmp_path / "lab" / "pilot")
    assert find_lab_folder() == Path("..")
    make_lab_folder(Path(), FILES)
    assert find_lab_folder() == Path()
    monkeypatch.chdir(ROOT / "tests")
    assert find_lab_folder() == Path("..")
    (tmp_path / "gone").mkdir()
    monkeypatch.chdir(tmp_path / "gone")
    (tmp_path / "gone").rmdir()
    assert find_lab_folder() is None


def test_a_lab_folder_starts_with_the_examples(tmp_path: Path) -> None:
    """Protocols, rig files and calibration are those of the checkout, without what a rig remembers."""
    examples = read_examples()
    for pattern in ("protocols/*.yaml", "calibration/rig-*.yaml", "calibration/simulated-*"):
        for path in ROOT.glob(pattern):
            assert examples[path.relative_to(ROOT).as_posix()] == path.read_bytes()
    assert not any("state.json" in place for place in examples)
    make_lab_folder(tmp_path / "lab", examples)
    assert (tmp_path / "lab" / RUNS).is_dir()
    assert b"/data/runs/" in (tmp_path / "lab" / ".gitignore").read_bytes()


def test_a_second_init_adds_what_is_missing_and_replaces_the_schemas_alone(tmp_path: Path) -> None:
    """A changed example is kept and named; a repository may become a lab folder, and keeps its own .gitignore."""
    (tmp_path / ".gitignore").write_bytes(b"mine")
    written, kept = make_lab_folder(tmp_path, FILES)
    assert (set(FILES) <= set(written), kept) == (True, (".gitignore",))
    (tmp_path / "protocols/a.yaml").write_bytes(b"my a")
    (tmp_path / "protocols/b.yaml").unlink()
    written, kept = make_lab_folder(tmp_path, {**FILES, **dict.fromkeys(SCHEMAS, b"new")})
    assert (set(written), set(kept)) == ({"protocols/b.yaml", *SCHEMAS}, {"protocols/a.yaml", ".gitignore"})
    assert (tmp_path / "protocols/a.yaml").read_bytes() == b"my a"
    assert (tmp_path / SCHEMAS[0]).read_bytes() == b"new"


def test_a_full_disk_leaves_a_lab_folder_that_is_completed_later(tmp_path: Path) -> None:
    """The error names the file."""
    large = {**FILES, "protocols/large.yaml": b"x" * 100_000}
    with full_disk(50_000), pytest.raises(DiskError, match=r"large\.yaml"):
        make_lab_folder(tmp_path / "lab", large)
    make_lab_folder(tmp_path / "lab", large)
    assert all((tmp_path / "lab" / place).read_bytes() == content for place, content in large.items())


def test_a_folder_with_other_files_is_refused(tmp_path: Path) -> None:
    """So is a file; each error says what to do."""
    (tmp_path / "thesis.tex").touch()
    with pytest.raises(OutputExistsError, match=r"holds other files: thesis\.tex") as refused:
        make_lab_folder(tmp_path, FILES)
    assert refused.value.hint == f"name a new folder: labrig init {tmp_path / 'lab'}"
    with pytest.raises(OutputExistsError, match="is a file"):
        make_lab_folder(tmp_path / "thesis.tex", FILES)
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.tex"]
