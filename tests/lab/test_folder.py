"""Which folder is a lab's, and where runs go."""

from pathlib import Path

import pytest

from labrig.lab.folder import MARKER, RUNS, RUNS_DIR_VARIABLE, choose_runs_dir, find_lab_folder

ROOT = Path(__file__).parents[2]


@pytest.fixture
def lab(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Work in a subfolder of a lab folder."""
    (tmp_path / "lab" / "protocols" / "pilot").mkdir(parents=True)
    (tmp_path / "lab" / MARKER).touch()
    monkeypatch.chdir(tmp_path / "lab" / "protocols" / "pilot")
    monkeypatch.delenv(RUNS_DIR_VARIABLE, raising=False)
    return tmp_path / "lab"


def test_runs_go_where_the_nearest_of_four_says(lab: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In this order: --runs-dir, LABRIG_RUNS_DIR, the lab folder upwards, the working folder."""
    monkeypatch.setenv(RUNS_DIR_VARIABLE, "/other/runs")
    assert choose_runs_dir(Path("here")).path == Path("here")
    assert choose_runs_dir().path == Path("/other/runs")
    monkeypatch.setenv(RUNS_DIR_VARIABLE, "")
    assert choose_runs_dir().path == Path("../..") / RUNS
    assert choose_runs_dir().reason == f"in the lab folder {lab}"
    monkeypatch.chdir(lab.parent)
    assert choose_runs_dir().path == RUNS


def test_the_nearest_lab_folder_counts(lab: Path) -> None:
    """A lab folder inside another one is a lab of its own; names are relative to the working folder."""
    assert find_lab_folder() == Path("../..")
    Path(MARKER).touch()
    assert find_lab_folder() == Path()


def test_a_checkout_is_a_lab_folder(monkeypatch: pytest.MonkeyPatch) -> None:
    """It has no marker, and its schemas stand where labrig keeps them."""
    monkeypatch.chdir(ROOT / "tests")
    assert find_lab_folder() == Path("..")


def test_a_working_folder_that_is_gone_is_in_no_lab(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing fails for it before a file is read."""
    (tmp_path / "gone").mkdir()
    monkeypatch.chdir(tmp_path / "gone")
    (tmp_path / "gone").rmdir()
    assert find_lab_folder() is None
