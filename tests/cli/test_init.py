"""`labrig init`, and what the other commands do in a lab folder, in one of another version, and in none."""

import json
from pathlib import Path

import pytest

from labrig.cli.sources import Sources, read_sources
from labrig.lab.folder import MARKER, RUNS_DIR_VARIABLE
from tests.cli.conftest import Labrig


@pytest.fixture
def lab(labrig: Labrig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Make a lab folder, and work in it."""
    monkeypatch.chdir(tmp_path)
    for name in (RUNS_DIR_VARIABLE, "LABRIG_RIG"):
        monkeypatch.delenv(name, raising=False)
    made = labrig("init", "my lab", "--json")
    assert made.exit_code == 0
    assert "protocols/steerability.yaml" in made.json()["added"]
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
    kept = typed.document()
    assert (kept["protocol"], kept["rig"]) == ("protocols/design.yaml", "calibration/rig-simulated.yaml")
    monkeypatch.chdir(lab.parent)
    found = read_sources(Path("my lab/data/runs/one"), {"sources": kept})
    assert found.protocol.samefile(lab / "protocols/design.yaml")
    assert found.rig.samefile(lab / "calibration/rig-simulated.yaml")
    for elsewhere in (lab.parent / "a.yaml", Path("../a.yaml")):
        assert Sources(elsewhere, None, (), None).document()["protocol"] == str(elsewhere)


def test_the_folder_of_the_runs_may_be_set_for_a_session(
    lab: Path, labrig: Labrig, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Commands say so; a folder of another computer is refused, as for --runs-dir."""
    monkeypatch.setenv(RUNS_DIR_VARIABLE, "elsewhere")
    assert labrig("runs").err.startswith("runs: elsewhere, as LABRIG_RUNS_DIR says")
    assert "there is no run one, neither here nor in elsewhere" in labrig("report", "one").err
    monkeypatch.setenv(RUNS_DIR_VARIABLE, "s3://lab/runs")
    refused = labrig("run", "steerability")
    assert refused.exit_code == 2
    assert "LABRIG_RUNS_DIR s3:" in refused.err


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


@pytest.mark.parametrize(
    ("marker", "told", "remedy"),
    [
        ({"labrig": "0.0.1"}, "are of labrig 0.0.1, this is", "bring them up to date: labrig init --update"),
        ({"labrig": "99.1"}, "was made by labrig 99.1, which is newer", "install labrig 99.1 or a newer one"),
        ({"format": 2}, "has format 2, and formats up to 1 are read", "install a newer labrig"),
    ],
)
def test_a_lab_folder_of_another_labrig_is_named(
    lab: Path, labrig: Labrig, marker: dict[str, object], told: str, remedy: str
) -> None:
    """A check and a list of the runs work all the same, and say what brings the two together."""
    written = json.loads((lab / MARKER).read_text(encoding="utf-8"))
    (lab / MARKER).write_text(json.dumps({**written, **marker}), encoding="utf-8")
    for command in (("check", "steerability"), ("runs",)):
        done = labrig(*command)
        assert done.exit_code == 0
        assert told in done.err
        assert remedy in done.err


def test_an_update_names_what_it_kept(lab: Path, labrig: Labrig) -> None:
    """The example that labrig has now can be compared with the changed file."""
    changed = lab / "protocols" / "design.yaml"
    changed.write_text("# ours\n", encoding="utf-8")
    marker = json.loads((lab / MARKER).read_text(encoding="utf-8"))
    marker["files"]["protocols/design.yaml"] = "0" * 64
    (lab / MARKER).write_text(json.dumps({**marker, "labrig": "0.0.1"}), encoding="utf-8")
    updated = labrig("init", "--update")
    assert updated.exit_code == 0
    assert "kept      protocols/design.yaml" in updated.out
    assert "diff protocols/design.yaml" in updated.err
    assert changed.read_text(encoding="utf-8") == "# ours\n"


def test_a_lab_folder_is_not_made_twice(lab: Path, labrig: Labrig) -> None:
    """The hint brings it up to date instead."""
    refused = labrig("init")
    assert refused.exit_code == 2
    assert refused.err.splitlines()[-1] == "hint: bring it up to date: labrig init --update"
    assert labrig("init", "--update").exit_code == 0


def test_the_name_of_a_kept_run_is_refused_before_anything_begins(lab: Path, labrig: Labrig) -> None:
    """Nothing is said of a run that does not begin."""
    (lab / "data" / "runs" / "first").mkdir()
    refused = labrig("run", "steerability", "--run-name", "first")
    assert refused.exit_code == 2
    assert refused.err.startswith("error: data/runs/first exists already")
