"""House rules that no linter holds, read off the source."""

import ast
import re
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from labrig.protocol.yaml_text import load_yaml_values

ROOT = Path(__file__).parents[1]
SOURCES = sorted((ROOT / "labrig").rglob("*.py"))
TESTS = sorted((ROOT / "tests").rglob("test_*.py"))
LONGEST_FUNCTION = 50


def _tree(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


def _functions(tree: ast.Module) -> Iterator[ast.FunctionDef]:
    return (node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef))


def _room(path: Path) -> str:
    return path.relative_to(ROOT / "labrig").parts[0]


def _imports_inside_functions(path: Path) -> bool:
    inside = (inner for function in _functions(_tree(path)) for inner in ast.walk(function))
    return any(isinstance(inner, ast.Import | ast.ImportFrom) for inner in inside)


def test_imports_inside_functions_stand_in_cli_alone() -> None:
    """Only cli/ imports inside functions, for its start-up time, and the files that are named here."""
    importing = {
        path.relative_to(ROOT / "labrig").as_posix()
        for path in SOURCES
        if _room(path) not in {"cli", "manual"} and _imports_inside_functions(path)
    }
    assert importing <= {
        "library/door.py",  # `import labrig` loads what is called
        "library/names.py",
        "library/pools.py",  # dask, which is not installed with labrig
        "record/catalogue.py",  # a list of runs needs no reader
        "runner/whole_run.py",  # what draws is loaded after the processes that measure are forked
    }


def _body_lines(function: ast.FunctionDef) -> int:
    """Count a function's lines without its signature, which for a command holds its options, and its docstring."""
    body = function.body[1:] if ast.get_docstring(function) is not None else function.body
    return (function.end_lineno or 0) - body[0].lineno + 1 if body else 0


def test_functions_fit_on_a_screen() -> None:
    """No function of labrig is longer than fifty lines, its signature and docstring left out."""
    lengths = {
        f"{path}:{function.lineno} {function.name}": _body_lines(function)
        for path in SOURCES
        for function in _functions(_tree(path))
    }
    assert {name: length for name, length in lengths.items() if length > LONGEST_FUNCTION} == {}


def test_every_test_states_a_behaviour() -> None:
    """Each test function has a docstring: the behaviour, in a sentence."""
    offenders = [
        f"{path}:{function.lineno} {function.name}"
        for path in TESTS
        for function in _functions(_tree(path))
        if function.name.startswith("test_") and not ast.get_docstring(function)
    ]
    assert offenders == []


def test_every_room_says_what_it_is_in_its_first_line() -> None:
    """The docstring of each room starts with its name and its one sentence."""
    for door in sorted((ROOT / "labrig").glob("*/__init__.py")):
        docstring = ast.get_docstring(_tree(door)) or ""
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
            path.relative_to(ROOT / "labrig").as_posix() for path in SOURCES if _room(path) == "devices"
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
    found = {
        path.relative_to(ROOT / "labrig").as_posix()
        for path in SOURCES
        if re.search(pattern, path.read_text(encoding="utf-8"), re.MULTILINE)
    }
    assert found <= places


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
    names = (name for name in listed.stdout.splitlines() if not name.endswith((".png", ".npz")))
    texts = {
        name: (ROOT / name).read_text(encoding="utf-8", errors="replace")
        for name in names
        if (ROOT / name).is_file() and not ("sleep" in what and name.startswith("labrig/devices/"))
    }
    assert [name for name, text in texts.items() if re.search(pattern, text)] == []


def test_a_commit_is_checked_as_make_checks_the_code() -> None:
    """The hooks of pre-commit are ruff and the commands of `make check`, in the same order."""
    recipe = (ROOT / "Makefile").read_text(encoding="utf-8").split("\ncheck:")[1].split("\n\n")[0]
    checks = re.findall(r"^\t\$\(BIN\)/(.+)$", recipe, re.MULTILINE)
    commands = ["ruff check .", "ruff format --check .", *checks]
    hooks: Any = load_yaml_values(ROOT / ".pre-commit-config.yaml")["repos"]
    (local,) = hooks
    assert [hook["entry"] for hook in local["hooks"]] == [f".venv/bin/{command}" for command in commands]
