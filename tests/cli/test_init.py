"""`labrig init`, and what the other commands do in a lab folder, in one of another version, and in none."""

import json
from pathlib import Path

import pytest

from labrig.lab import RUNS_DIR_VARIABLE
from labrig.library.sources import Sources, find_recorded_rig
from tests.cli.conftest import Labrig


@pytest.fixture
def lab(labrig: Labrig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Make a lab folder, and work in it."""
    monkeypatch.chdir(tmp_path)
    for name in (RUNS_DIR_VARIABLE, "LABRIG_RIG"):
        monkeypatch.delenv(name, raising=False)
    made = labrig("init", "my lab", "--json")
    assert made.exit_code == 0
    assert "protocols/steerability.yaml" in made.json()["written"]
    monkeypatch.chdir(tmp_path / "my lab")
    return tmp_path / "my lab"


def test_a_protocol_is_named_in_any_folder_of_the_lab(
    lab: Path, labrig: Labrig, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Protocol, rig, calibration and runs are those of the lab folder; what was probably meant is named."""
    monkeypatch.chdir(lab / "data")
    checked = labrig("check", "steerability", "--json")
    assert (checked.exit_code, checked.json()["ok"]) == (0, True)
    assert checked.err.strip() == f"runs: ../data/runs, in the lab folder {lab}"
    assert "did you mean steerability?" in labrig("run", "sterability").err
    assert (
        labrig("runs")
        .err.splitlines()[-1]
        .startswith(f"no runs in ../data/runs, in the lab folder {lab}; make")
    )


def test_a_manifest_names_its_sources_from_the_lab_folder(lab: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Wherever in the lab folder a run was started, it can be resumed from any other folder."""
    monkeypatch.chdir(lab / "data")
    typed = Sources(Path("../protocols/design.yaml"), Path("../calibration/rig-simulated.yaml"), (), None)
    kept = typed.document(has_rig=True)
    assert (kept["protocol"], kept["rig"]) == ("protocols/design.yaml", "calibration/rig-simulated.yaml")
    monkeypatch.chdir(lab.parent)
    rig, _ = find_recorded_rig(Path("my lab/data/runs/one"), {"sources": kept})
    assert rig is not None
    assert rig.samefile(lab / "calibration/rig-simulated.yaml")
    for elsewhere in (lab.parent / "a.yaml", Path("../a.yaml")):
        assert Sources(elsewhere, None, (), None).document(has_rig=False)["protocol"] == str(elsewhere)


def test_the_folder_of_the_runs_may_be_set_for_a_session(
    lab: Path, labrig: Labrig, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Commands say so."""
    monkeypatch.setenv(RUNS_DIR_VARIABLE, "elsewhere")
    assert labrig("runs").err.startswith("runs: elsewhere, as LABRIG_RUNS_DIR says")
    assert "there is no run one, neither here nor in elsewhere" in labrig("report", "one").err


def test_the_schemas_of_a_lab_folder_are_where_its_files_name_them(lab: Path) -> None:
    """An editor completes each YAML file by its first line, and new files by the settings."""
    settings = json.loads((lab / ".vscode/settings.json").read_text(encoding="utf-8"))
    assert all((lab / schema).is_file() for schema in settings["yaml.schemas"])
    for file in (*lab.glob("protocols/*.yaml"), *lab.glob("calibration/*.yaml")):
        named = file.read_text(encoding="utf-8").splitlines()[0].partition("$schema=")[2]
        assert (file.parent / named).is_file(), file


def test_without_a_lab_folder_labrig_says_how_to_make_one(
    labrig: Labrig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A protocol that is only named is wrong input then; the list of runs says where it has looked."""
    monkeypatch.chdir(tmp_path)
    refused = labrig("run", "steerability")
    assert refused.exit_code == 2
    assert "labrig init FOLDER" in refused.err
    assert (
        "no runs in data/runs, below the working folder, as no lab folder is here or above"
        in labrig("runs").err
    )
    assert not list(tmp_path.iterdir())


def test_the_name_of_a_kept_run_is_refused_before_anything_begins(lab: Path, labrig: Labrig) -> None:
    """Nothing is said of a run that does not begin."""
    (lab / "data" / "runs" / "first").mkdir()
    refused = labrig("run", "steerability", "--run-name", "first")
    assert refused.exit_code == 2
    assert refused.err.startswith("error: data/runs/first exists already")
