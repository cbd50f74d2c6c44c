"""What a shell is given to complete a command line."""

from pathlib import Path

import pytest

from tests.cli.conftest import Labrig


@pytest.mark.parametrize(
    ("line", "completed"),
    [
        ("labrig resu", ["resume"]),
        ("labrig resume --li", ["--live"]),
        ("labrig runs sh", ["show"]),
        ("labrig resume ", ["last", "b", "a"]),
        ("labrig run proto", []),
    ],
)
def test_commands_options_and_runs_are_completed(
    line: str, completed: list[str], labrig: Labrig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Names of runs in data/runs are offered where a run is wanted; files are left to the shell."""
    for name in ("a", "b", ".hidden"):
        (tmp_path / "data" / "runs" / name).mkdir(parents=True)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("_LABRIG_COMPLETE", "complete_bash")
    monkeypatch.setenv("COMP_WORDS", line)
    monkeypatch.setenv("COMP_CWORD", str(len(line.split(" ")) - 1))
    done = labrig()
    assert (done.exit_code, done.out.split()) == (0, completed)
