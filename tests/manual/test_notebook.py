"""The notebook of the manual."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import nbformat
import pytest

from tests.manual.lab import make_lab_folder
from tests.manual.pages import ROOT

NOTEBOOK = ROOT / "labrig" / "manual" / "example" / "two-needles.ipynb"


def _run(notebook: Path, folder: Path) -> subprocess.CompletedProcess[str]:
    environment = {
        **os.environ,
        "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}",
        "PYTHONPATH": str(ROOT),
        "MPLBACKEND": "agg",
        "IPYTHONDIR": str(folder / "ipython"),
    }
    return subprocess.run(
        [sys.executable, "-m", "tests.manual.notebook", str(notebook)],
        cwd=folder, env=environment, capture_output=True, text=True, check=False, timeout=300,
    )  # fmt: skip


@pytest.mark.skipif(shutil.which("sh") is None, reason="its lines for a shell need one")
def test_the_notebook_runs_in_a_lab_folder(tmp_path: Path) -> None:
    """From its runs to the figure for a paper, as it stands."""
    done = _run(NOTEBOOK, make_lab_folder(tmp_path))
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "two-needles.svg").stat().st_size > 1000
    assert (tmp_path / "two-needles.pdf").read_bytes().startswith(b"%PDF")


def test_the_notebook_holds_what_its_cells_show() -> None:
    """Every cell that ends in a value has been run, and shows no error and no folder of the computer."""
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    nbformat.validate(notebook)
    cells = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert [cell.execution_count for cell in cells] == list(range(1, len(cells) + 1))
    assert all(cell.outputs for cell in cells)
    assert {output.output_type for cell in cells for output in cell.outputs} <= {"stream", "execute_result"}
    assert any("image/svg+xml" in output.get("data", {}) for cell in cells for output in cell.outputs)
    assert str(Path.home()) not in NOTEBOOK.read_text(encoding="utf-8")


def test_a_cell_that_fails_is_found(tmp_path: Path) -> None:
    """The error names the cell."""
    notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell("1 / 0")])
    nbformat.write(notebook, tmp_path / "bad.ipynb")
    done = _run(tmp_path / "bad.ipynb", tmp_path)
    assert (done.returncode, "1 / 0" in done.stderr, "ZeroDivisionError" in done.stderr) == (1, True, True)
