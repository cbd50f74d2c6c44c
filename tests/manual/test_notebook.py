"""The notebook of the manual."""

import json
import os
import subprocess
import sys
from pathlib import Path

from tests.manual.lab import make_lab_folder
from tests.manual.pages import ROOT

NOTEBOOK = ROOT / "labrig" / "manual" / "example" / "first-sweep.ipynb"


def test_the_notebook_runs_in_a_lab_folder(tmp_path: Path) -> None:
    """A sweep, its radii, and two runs compared: its code as it stands, which is plain Python."""
    cells = json.loads(NOTEBOOK.read_text(encoding="utf-8"))["cells"]
    code = "\n".join("".join(cell["source"]) for cell in cells if cell["cell_type"] == "code")
    assert "labrig.compare" in code
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "MPLBACKEND": "agg"}
    folder = make_lab_folder(tmp_path)
    subprocess.run([sys.executable, "-c", code], cwd=folder, env=environment, check=True, timeout=300)
    assert len(list((tmp_path / "data" / "runs").iterdir())) == 2
