"""What code ran, with which packages, on which computer."""

import json
import platform
import shutil
import subprocess
from importlib import metadata
from pathlib import Path

import pytest

import labrig
from labrig.record.provenance import (
    _read_git_state,
    collect_code_diff,
    collect_provenance,
)


def test_provenance_names_code_packages_and_computer() -> None:
    """It is JSON, names the versions of what labrig depends on itself, and of the program only the name."""
    found = collect_provenance(["/somewhere/bin/labrig", "run", "a b.yaml"])
    assert json.loads(json.dumps(found)) == found
    assert found["labrig"] == labrig.__version__
    assert found["command_line"] == ["labrig", "run", "a b.yaml"]
    assert found["python"] == platform.python_version()
    packages = found["packages"]
    assert isinstance(packages, dict)
    assert packages["numpy"] == metadata.version("numpy")
    assert {"opencv-python-headless", "scipy", "canopen"} <= packages.keys()
    assert not {"pytest", "ruff"} & packages.keys()


def test_the_same_state_gives_the_same_provenance() -> None:
    """Nothing in it depends on the moment or on where it is called."""
    assert collect_provenance(["labrig"]) == collect_provenance(["labrig"])


@pytest.mark.skipif(shutil.which("git") is None, reason="git is not installed")
def test_a_changed_checkout_is_dirty(tmp_path: Path) -> None:
    """The commit is named, and a change of the code, but not of data beside it, makes it dirty."""
    (tmp_path / "labrig").mkdir()
    code = tmp_path / "labrig" / "code.py"
    code.write_text("1\n")
    identity = ["-c", "user.name=n", "-c", "user.email=e"]
    for words in (["init", "-q"], ["add", "."], [*identity, "commit", "-q", "-m", "first"]):
        subprocess.run(["git", "-C", tmp_path, *words], check=True)
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "run").write_text("")
    state = _read_git_state(tmp_path)
    assert len(str(state["git_commit"])) == 40
    assert state["git_dirty"] is False
    code.write_text("2\n")
    assert _read_git_state(tmp_path) == {**state, "git_dirty": True}


@pytest.mark.skipif(shutil.which("git") is None, reason="git is not installed")
def test_what_the_code_differs_from_its_commit_can_be_applied(tmp_path: Path) -> None:
    """Changed and new files of the package are in the patch, data beside it is not, and git can apply it."""
    tree, identity = tmp_path / "tree", ["-c", "user.name=n", "-c", "user.email=e"]
    (tree / "labrig").mkdir(parents=True)
    (tree / "labrig" / "code.py").write_text("1\n")
    for words in (["init", "-q"], ["add", "."], [*identity, "commit", "-q", "-m", "first"]):
        subprocess.run(["git", "-C", tree, *words], check=True)
    assert collect_code_diff(tree) == b""
    subprocess.run(["git", "clone", "-q", tree, tmp_path / "other"], check=True)
    (tree / "labrig" / "code.py").write_text("2\n")
    (tree / "labrig" / "größe.py").write_text("3\n")
    (tree / "notes").write_text("")
    diff = collect_code_diff(tree)
    subprocess.run(["git", "-C", tmp_path / "other", "apply", "-"], input=diff, check=True)
    copied = {path.name: path.read_text() for path in (tmp_path / "other" / "labrig").iterdir()}
    assert copied == {"code.py": "2\n", "größe.py": "3\n"}
    assert b"notes" not in diff


@pytest.mark.skipif(shutil.which("git") is None, reason="git is not installed")
def test_new_files_that_are_no_code_stay_out_of_the_record(tmp_path: Path) -> None:
    """Of new files only Python is in the patch; .env, keys, links and hidden files are left out."""
    tree, identity = tmp_path / "tree", ["-c", "user.name=n", "-c", "user.email=e"]
    room = tree / "labrig" / "room"
    room.mkdir(parents=True)
    (room / "code.py").write_text("1\n")
    for words in (["init", "-q"], ["add", "."], [*identity, "commit", "-q", "-m", "first"]):
        subprocess.run(["git", "-C", tree, *words], check=True)
    private = (".env", ".env.py", "id_rsa", "patients.csv", ".cache/code.py")
    (room / ".cache").mkdir()
    for name in private:
        (room / name).write_text("SECRET")
    (tmp_path / "outside.py").write_text("SECRET")
    (room / "link.py").symlink_to(tmp_path / "outside.py")
    (room / "code.py").write_text("2\n")
    (room / "new.py").write_text("3\n")
    diff = collect_code_diff(tree)
    assert b"+2" in diff
    assert b"+3" in diff
    assert b"SECRET" not in diff
    assert b"outside.py" not in diff


def test_code_that_is_no_checkout_says_so(tmp_path: Path) -> None:
    """Installed code has no commit, which is null and not clean."""
    assert _read_git_state(tmp_path) == {"git_commit": None, "git_dirty": None}
