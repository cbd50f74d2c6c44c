"""The commands of the manual and its notebook run as they stand, page by page, each page in a lab folder of its own."""

import contextlib
import io
import json
import os
import re
import shlex
import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from labrig.cli.main import run_command
from tests.manual.pages import PAGES, README, ROOT, Fence, Line, list_blocks, list_lines

_FOR_A_SHELL = re.compile(r"[|<>;&$*?`]")


def make_lab_folder(folder: Path) -> Path:
    """Return a new lab folder."""
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        assert run_command(["init", str(folder)]) == 0
    return folder


@dataclass
class Lab:
    """The working folder of this process, and the names that the Python of a page has defined."""

    names: dict[str, Any] = field(default_factory=lambda: {"__name__": "__main__"})

    def run(self, block: Fence) -> None:
        """Run a block as it stands; fail with its page's line if it ends otherwise than it says."""
        if block.info == "python":
            with contextlib.redirect_stdout(io.StringIO()):
                exec(compile(block.text, f"block at line {block.line}", "exec"), self.names)
            return
        for line in list_lines(block):
            exit_code, said = _run_line(line.command)
            assert (line.command, exit_code) == (line.command, line.exit_code), said


def _run_line(command: str) -> tuple[int, str]:
    """Run a line: a plain labrig in this process, which is faster, anything else by a shell."""
    words = shlex.split(command, comments=True)
    unquoted = re.sub(r"'[^']*'|\"[^\"]*\"", "", command.partition(" #")[0])
    if words[0] == "labrig" and not _FOR_A_SHELL.search(unquoted):
        said = io.StringIO()
        with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
            return run_command(words[1:]), said.getvalue()
    done = run_shell(command, Path())
    return done.returncode, done.stdout + done.stderr


def run_shell(script: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """Run a script by bash, with the labrig of this environment."""
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    return subprocess.run(
        ["bash", "-c", script], cwd=folder, env={**os.environ, "PATH": path}, stdin=subprocess.DEVNULL,
        capture_output=True, text=True, check=False, timeout=300,
    )  # fmt: skip


def run_script(lines: list[Line], folder: Path) -> None:
    """Run lines in order by one bash, beginning in a folder; each must end as it says, and a `cd` lasts."""
    checked = [
        f"{line.command}\n(exit $?) ; code=$?; [ $code -eq {line.exit_code} ] || "
        f"{{ echo {shlex.quote(line.command)} ended with $code >&2; exit 99; }}"
        for line in lines
    ]
    done = run_shell("\n".join(checked), folder)
    assert done.returncode == 0, done.stdout + done.stderr


RUNNING = {place: page for place, page in PAGES.items() if list_blocks(page, "sh", "python")}


@pytest.mark.slow
@pytest.mark.parametrize("page", RUNNING.values(), ids=RUNNING)
def test_the_commands_of_a_page_run(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In order, each with the exit code that it is said to have; so does the Python between them."""
    monkeypatch.chdir(make_lab_folder(tmp_path))
    monkeypatch.setenv("MPLBACKEND", "agg")
    lab = Lab()
    for block in list_blocks(page, "sh", "python"):
        lab.run(block)


def test_a_command_of_a_script_that_ends_otherwise_is_found(tmp_path: Path) -> None:
    """There a change of folder lasts."""
    run_script([Line("mkdir a && cd a", 0), Line("false", 1), Line("touch b", 0)], tmp_path)
    assert (tmp_path / "a" / "b").is_file()
    with pytest.raises(AssertionError, match="false ended with 1"):
        run_script([Line("false", 0)], tmp_path)


def test_the_commands_of_the_readme_run(tmp_path: Path) -> None:
    """In order, by a shell with the real command, beginning in an empty folder."""
    lines = [line for block in list_blocks(README, "sh") for line in list_lines(block)]
    assert lines[0].command.startswith("labrig init")
    run_script(lines, tmp_path)


NOTEBOOK = ROOT / "labrig" / "manual" / "example" / "first-sweep.ipynb"


@pytest.mark.slow
def test_the_notebook_runs_in_a_lab_folder(tmp_path: Path) -> None:
    """A sweep, its radii, and two runs compared: its code as it stands, which is plain Python."""
    cells = json.loads(NOTEBOOK.read_text(encoding="utf-8"))["cells"]
    code = "\n".join("".join(cell["source"]) for cell in cells if cell["cell_type"] == "code")
    assert "labrig.compare" in code
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "MPLBACKEND": "agg"}
    folder = make_lab_folder(tmp_path)
    subprocess.run([sys.executable, "-c", code], cwd=folder, env=environment, check=True, timeout=300)
    assert len(list((tmp_path / "data" / "runs").iterdir())) == 2
