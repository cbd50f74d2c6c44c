"""The notebook of the manual."""

import os
import subprocess
import sys
from pathlib import Path

import nbformat

from tests.manual.lab import make_lab_folder
from tests.manual.pages import ROOT

NOTEBOOK = ROOT / "labrig" / "manual" / "example" / "first-sweep.ipynb"


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


def test_the_notebook_runs_in_a_lab_folder(tmp_path: Path) -> None:
    """A sweep, its radii, and two runs compared, as it stands."""
    done = _run(NOTEBOOK, make_lab_folder(tmp_path))
    assert done.returncode == 0, done.stderr
    assert len(list((tmp_path / "data" / "runs").iterdir())) == 2


def test_a_cell_that_fails_is_found(tmp_path: Path) -> None:
    """The error names the cell."""
    notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell("1 / 0")])
    nbformat.write(notebook, tmp_path / "bad.ipynb")
    done = _run(tmp_path / "bad.ipynb", tmp_path)
    assert (done.returncode, "1 / 0" in done.stderr, "ZeroDivisionError" in done.stderr) == (1, True, True)
