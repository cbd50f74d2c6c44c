"""The commands of the manual and its notebook run as they stand, page by page, each page in a lab folder of its own."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.manual.lab import Lab, make_lab_folder, run_script
from tests.manual.pages import PAGES, README, ROOT, Line, list_blocks, list_lines

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


def test_a_command_that_ends_otherwise_is_found(tmp_path: Path) -> None:
    """So is one in a script for a shell; there a change of folder lasts."""
    run_script([Line("mkdir a && cd a", 0), Line("false", 1), Line("touch b", 0)], tmp_path)
    assert (tmp_path / "a" / "b").is_file()
    with pytest.raises(AssertionError, match="false ended with 1"):
        run_script([Line("false", 0), Line("touch c", 0)], tmp_path)
    assert not (tmp_path / "c").exists()


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
