"""How rooms hand out their names."""

import ast
import importlib
import json
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import labrig

ROOT = Path(__file__).parents[1] / "labrig"
PROJECT = tomllib.loads((ROOT.parent / "pyproject.toml").read_text(encoding="utf-8"))
CONTRACTS = {contract["name"]: contract for contract in PROJECT["tool"]["importlinter"]["contracts"]}
ROOMS = sorted(door.parent.name for door in ROOT.glob("*/__init__.py"))
ANALYSES = [
    "labrig.analysis.run",
    *(f"labrig.experiments.{path.parent.name}.analysis" for path in ROOT.glob("experiments/*/analysis.py")),
]
INSIDE = {"The bus stays inside devices": {"devices"}}
"""Contract -> the rooms that are not on its list."""
DOCUMENTED = {
    "analysis": {"load_runs"},
    "experiments": {"Experiment"},
    "record": {"open_run"},
    "steering": {"estimate_tip_poses", "plan_path"},
    "vision": {"calibrate_intrinsics", "fit_circle", "load_intrinsics", "load_plane"},
}


def _find_loaded(code: str, packages: tuple[str, ...]) -> list[str]:
    """Return which of the packages a new Python has loaded after some code."""
    code += f"\nimport sys, json; print(json.dumps([one for one in {packages!r} if one in sys.modules]))"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=300
    )
    loaded: list[str] = json.loads(done.stdout.splitlines()[-1])
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
        ("labrig.record.catalogue, labrig.record.notes", ("numpy", "pandas", "cv2", "ruamel")),
        ("labrig.steering.parameters", ("numpy", "scipy")),
        ("labrig.record.check", ("pandas",)),
        ("labrig.protocol.load", ("cv2", "numpy", "pandas", "scipy", "matplotlib", "rerun", "can", "typer", "jinja2")),
        ("labrig.devices.clocks", ("numpy", "cv2", "can", "canopen", "pydantic")),
        ("labrig.runner.experiment", ("matplotlib", "jinja2")),
        ("labrig.library.door, labrig.cli.attendant", ("rerun",)),
        ("labrig.analysis.comparison, labrig.experiments.roll_zero.analysis", ("scipy.stats",)),
        (", ".join(ANALYSES), ("can", "canopen", "labrig.devices")),
    ],
)  # fmt: skip
def test_what_is_not_asked_for_is_not_loaded(modules: str, unneeded: tuple[str, ...]) -> None:
    """A file brings the packages that it needs, and not those of its neighbours."""
    assert _find_loaded(f"import {modules}", unneeded) == []


def test_every_room_is_named_where_labrig_says_what_it_is() -> None:
    """The docstring of the package has a line for each room, and for each file beside them."""
    files = {path.stem for path in ROOT.glob("*.py")} - {"__init__", "__main__"}
    lines = [line for line in (labrig.__doc__ or "").splitlines() if line.startswith("- ")]
    named = {name for line in lines for name in re.findall(r"`(\w+)`", line)}
    assert named == {*ROOMS, *files}


def test_every_room_is_on_every_list_of_the_import_linter() -> None:
    """What stays inside a room is forbidden to each of the others; a new room cannot be forgotten."""
    top = {path.stem for path in ROOT.glob("*.py")} - {"__init__", "__main__"} | set(ROOMS)
    for name, inside in INSIDE.items():
        listed = {module.split(".")[1] for module in CONTRACTS[name]["source_modules"]}
        assert (name, listed) == (name, top - inside)
    layers = CONTRACTS["A room imports only what stands below it"]["layers"]
    assert {room.strip("( )") for layer in layers for room in layer.split("|")} >= top


def test_every_experiment_is_on_the_lists_of_the_import_linter() -> None:
    """None imports another, and the parts that compute reach nothing that moves, by the names that parts have."""
    folders = {path.parent.name for path in ROOT.glob("experiments/*/__init__.py")} - {"shared"}
    independent = CONTRACTS["No experiment imports another"]["modules"]
    assert {module.rpartition(".")[2] for module in independent} == folders
    computing = CONTRACTS["What computes never reaches what moves"]["source_modules"]
    parts = {"analysis", "events", "page", "protocol", "result"}
    assert set(computing) >= {f"labrig.experiments.*.{part}" for part in parts}
