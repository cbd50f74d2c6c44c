"""How rooms hand out their names."""

import ast
import importlib
import json
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1] / "labrig"
ROOMS = sorted(door.parent.name for door in ROOT.glob("*/__init__.py"))
ANALYSES = [
    "labrig.analysis.batch",
    *(f"labrig.experiments.{path.parent.name}.analysis" for path in ROOT.glob("experiments/*/analysis.py")),
]
DOCUMENTED = {
    "experiments": {"ExperimentDeclaration"},
    "geometry": {"fit_circle"},
    "record": {"open_run"},
    "report": {"run_tables"},
    "steering": {"estimate_tip_poses", "plan_path"},
    "vision": {"calibrate_intrinsics"},
}


def _loaded_by(code: str, packages: tuple[str, ...]) -> list[str]:
    """Return which of the packages a new Python has loaded after some code."""
    code += f"\nimport sys, json; print(json.dumps([one for one in {packages!r} if one in sys.modules]))"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60
    )
    loaded: list[str] = json.loads(done.stdout)
    return loaded


@pytest.mark.parametrize("room", ROOMS)
def test_a_room_hands_out_its_documented_names_alone(room: str) -> None:
    """What the manual imports from a room is there, and nothing else of its files is imported with the room."""
    door = importlib.import_module(f"labrig.{room}")
    documented = DOCUMENTED.get(room, set())
    assert [name for name in documented if not callable(getattr(door, name))] == []
    tree = ast.parse((ROOT / room / "__init__.py").read_text(encoding="utf-8"))
    handed_out = {
        alias.name
        for node in tree.body
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("labrig.")
        for alias in node.names
    }
    assert handed_out <= documented


@pytest.mark.parametrize(
    ("modules", "unneeded"),
    [
        ("labrig.record.catalogue, labrig.record.annotations", ("numpy", "pandas", "cv2", "fsspec", "pydantic")),
        ("labrig.record.check, labrig.record.difference", ("pandas", "fsspec")),
        ("labrig.protocol.load", ("cv2", "numpy", "pandas", "scipy", "matplotlib", "rerun", "can", "typer", "jinja2")),
        ("labrig.devices.clocks", ("numpy", "cv2", "can", "canopen", "pydantic")),
        *((module, ("can", "canopen", "labrig.devices")) for module in ANALYSES),
    ],
)  # fmt: skip
def test_what_is_not_asked_for_is_not_loaded(modules: str, unneeded: tuple[str, ...]) -> None:
    """A file brings the packages that it needs, and not those of its neighbours."""
    assert _loaded_by(f"import {modules}", unneeded) == []
