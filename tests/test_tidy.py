"""House rules that no linter holds, read off the source; how rooms hand out their names."""

import ast
import importlib
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

import labrig

ROOT = Path(__file__).parents[1]
LABRIG = ROOT / "labrig"
SOURCES = {path.relative_to(LABRIG).as_posix(): path for path in LABRIG.rglob("*.py")}
LONGEST_FUNCTION = 50


def _functions(path: Path) -> Iterator[ast.FunctionDef]:
    nodes = ast.walk(ast.parse(path.read_text(encoding="utf-8")))
    return (node for node in nodes if isinstance(node, ast.FunctionDef))


def _body_lines(function: ast.FunctionDef) -> int:
    """Count a function's lines without its signature, which for a command holds its options, and its docstring."""
    body = function.body[1:] if ast.get_docstring(function) is not None else function.body
    return (function.end_lineno or 0) - body[0].lineno + 1 if body else 0


def test_functions_fit_on_a_screen() -> None:
    """No function of labrig is longer than fifty lines, its signature and docstring left out."""
    lengths = {
        f"{name} {function.name}": _body_lines(function)
        for name, path in SOURCES.items()
        for function in _functions(path)
    }
    assert {name: length for name, length in lengths.items() if length > LONGEST_FUNCTION} == {}


def test_every_room_says_what_it_is_in_its_first_line() -> None:
    """The docstring of each room starts with its name and its one sentence."""
    for door in sorted(LABRIG.glob("*/__init__.py")):
        docstring = ast.get_docstring(ast.parse(door.read_text(encoding="utf-8"))) or ""
        assert docstring.startswith(f"{door.parent.name}: "), door


WRITING = (
    r"\.write_(?:text|bytes)\(|open\([^)\n]*[\"'](?:[wxa]b?\+?|r\+b?|rb\+)[\"']|O_CREAT|\.touch\(|imwrite\(|\.tofile\("
    r"|NamedTemporaryFile|shutil\.(?:copy|move)|savefig\((?!buffer)|to_csv\([^i)]|savemat\((?!target)|os\.replace"
)


@pytest.mark.parametrize(
    ("pattern", "places"),
    [
        pytest.param(WRITING, {
            "durable.py",
            "cli/bug_report.py",  # the traceback of a bug, under a name that nothing has
            "cli/start.py",  # the null device in place of a closed stream
            "record/json_lines.py",  # appended to
            "record/output_folder.py",  # the copy of a record, in the temporary folder of an export
            "record/writer.py",  # the reserve of a new run
            "report/rerun_view.py",  # filled by a library, under a temporary name
            "report/tables.py",  # in the temporary folder of an export
        }, id="whole files are written through durable.py"),
        pytest.param(r"^(?:import|from) time\b", {
            name for name in SOURCES if name.startswith("devices/")
        }, id="clocks are injected"),
        pytest.param(r"TYPE_CHECKING", {
            "__init__.py",  # the names of the door
            "cli/calibrate_plane.py",
            "cli/terminal_operator.py",
            "runner/experiment.py",  # an analysis loads no devices
        }, id="the imports that are checked are those that run"),
        pytest.param(
            r"typer\.echo|(?<![.\w])print\(", {"cli/output.py"}, id="text for people passes through output.py"
        ),
    ],
)  # fmt: skip
def test_what_only_some_files_may_do_is_done_by_no_other(pattern: str, places: set[str]) -> None:
    """Files are written whole, clocks are injected, and control characters are kept from the terminal."""
    texts = {name: path.read_text(encoding="utf-8") for name, path in SOURCES.items()}
    assert {name for name, text in texts.items() if re.search(pattern, text, re.MULTILINE)} <= places


@pytest.mark.parametrize(
    ("what", "pattern"),
    [
        ("an address of a package registry", r"pypi\.o[r]g|pythonhosted\.o[r]g|registry\.npmj[s]"),
        ("a real sleep in a test", r"time\.slee[p]\("),
        ("a patched object", r"mock\.patc[h]|monkeypatch\.setatt[r]"),
    ],
)
def test_tracked_files_hold_none_of_these(what: str, pattern: str) -> None:
    """No tracked file holds a registry address, a sleep in a test or a patched object."""
    listed = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=False)
    if listed.returncode != 0:
        pytest.skip("not a git checkout, so the tracked files are not known")
    named = {name: ROOT / name for name in listed.stdout.splitlines() if not name.endswith((".png", ".npz"))}
    texts = {
        name: path.read_text(encoding="utf-8", errors="replace")
        for name, path in named.items()
        if path.is_file() and not ("sleep" in what and name.startswith("labrig/devices/"))
    }
    assert [name for name, text in texts.items() if re.search(pattern, text)] == []


PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
CONTRACTS = {contract["name"]: contract for contract in PROJECT["tool"]["importlinter"]["contracts"]}
ROOMS = sorted(door.parent.name for door in LABRIG.glob("*/__init__.py"))
ANALYSES = [
    "labrig.analysis.run",
    *(f"labrig.experiments.{path.parent.name}.analysis" for path in LABRIG.glob("experiments/*/analysis.py")),
]
DOCUMENTED = {
    "analysis": {"load_runs"},
    "experiments": {"Experiment"},
    "record": {"open_run"},
    "steering": {"estimate_tip_poses", "plan_path"},
    "vision": {"calibrate_intrinsics", "fit_circle", "load_intrinsics", "load_plane"},
}


@pytest.mark.parametrize("room", ROOMS)
def test_a_room_hands_out_its_documented_names_alone(room: str) -> None:
    """What the manual imports from a room is there, and nothing else of its files is imported with the room."""
    door = importlib.import_module(f"labrig.{room}")
    documented = DOCUMENTED.get(room, set())
    assert [name for name in documented if not callable(getattr(door, name))] == []
    tree = ast.parse((LABRIG / room / "__init__.py").read_text(encoding="utf-8"))
    handed_out = {
        alias.name
        for node in tree.body
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("labrig.")
        for alias in node.names
    }
    assert handed_out <= documented


# What a Python imports one after the other, and what it has not loaded then.
COMPUTING = {
    "labrig.steering.parameters": ("numpy", "scipy"),
    "labrig.record.catalogue, labrig.record.notes": ("numpy", "pandas", "cv2", "ruamel"),
    "labrig.protocol.load": (
        "cv2", "numpy", "pandas", "scipy", "matplotlib", "rerun", "can", "typer", "jinja2",
    ),
    "labrig.record.check": ("pandas",),
    "labrig.analysis.comparison, labrig.experiments.roll_zero.analysis": ("scipy.stats",),
    ", ".join(ANALYSES): ("can", "canopen", "labrig.devices"),
}  # fmt: skip
MOVING = {
    "labrig.devices.clocks": ("numpy", "cv2", "can", "canopen", "pydantic"),
    "labrig.library.door, labrig.cli.attendant": ("rerun",),
}


@pytest.mark.parametrize("rows", [COMPUTING, MOVING])
def test_what_is_not_asked_for_is_not_loaded(rows: dict[str, tuple[str, ...]]) -> None:
    """A file brings the packages that it needs, and not those of its neighbours."""
    code = "import sys\n" + "\n".join(
        f"import {modules}\nprint({modules!r}, [one for one in {unneeded!r} if one in sys.modules])"
        for modules, unneeded in rows.items()
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=300
    )
    assert done.stdout.splitlines() == [f"{modules} []" for modules in rows]


def test_every_room_is_named_where_labrig_says_what_it_is() -> None:
    """The docstring of the package has a line for each room, and for each file beside them."""
    files = {path.stem for path in LABRIG.glob("*.py")} - {"__init__", "__main__"}
    lines = [line for line in (labrig.__doc__ or "").splitlines() if line.startswith("- ")]
    assert {name for line in lines for name in re.findall(r"`(\w+)`", line)} == {*ROOMS, *files}


def test_every_room_and_experiment_is_on_the_lists_of_the_import_linter() -> None:
    """A new one cannot be forgotten: the bus stays inside devices, and what computes moves nothing."""
    top = {path.stem for path in LABRIG.glob("*.py")} - {"__init__", "__main__"} | set(ROOMS)
    listed = {module.split(".")[1] for module in CONTRACTS["The bus stays inside devices"]["source_modules"]}
    assert listed == top - {"devices"}
    layers = CONTRACTS["A room imports only what stands below it"]["layers"]
    assert {room.strip("( )") for layer in layers for room in layer.split("|")} >= top
    folders = {path.parent.name for path in LABRIG.glob("experiments/*/__init__.py")} - {"shared"}
    independent = CONTRACTS["No experiment imports another"]["modules"]
    assert {module.rpartition(".")[2] for module in independent} == folders
    computing = CONTRACTS["What computes never reaches what moves"]["source_modules"]
    parts = {"analysis", "events", "page", "protocol", "result"}
    assert set(computing) >= {f"labrig.experiments.*.{part}" for part in parts}
