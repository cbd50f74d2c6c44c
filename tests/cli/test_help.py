"""What `labrig --help` prints, what it does not import, and how many commands and options there are."""

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from typing import Any

import pytest
from typer.main import get_command

from labrig.cli.main import app, run_command
from labrig.cli.output import print_line
from tests.cli.conftest import RIG, SWEEP

HEAVY = (
    *("numpy", "cv2", "pandas", "scipy", "matplotlib", "rerun", "can", "canopen", "ruamel"),
    *("labrig.experiments", "pydantic", "rich"),
)
MOST_OPTIONS = 150


def _python(code: str, columns: int = 80) -> str:
    environment = {**os.environ, "COLUMNS": str(columns), "NO_COLOR": "1", "TERM": "dumb"}
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, env=environment, timeout=60
    )
    return done.stdout


def _walk(command: Any, path: tuple[str, ...] = ()) -> Iterator[tuple[str, Any]]:
    """Yield each command that does something, with its words."""
    for name, below in getattr(command, "commands", {}).items():
        yield from _walk(below, (*path, name))
    if path and (not hasattr(command, "commands") or command.invoke_without_command):
        yield " ".join(path), command


COMMANDS = dict(_walk(get_command(app)))


def test_there_are_few_commands_and_options() -> None:
    """Each command and each option is one more thing to learn."""
    options = [
        (name, param.opts[0])
        for name, command in COMMANDS.items()
        for param in command.params
        if param.param_type_name == "option"
    ]
    assert len(COMMANDS) <= 35
    assert len(options) <= MOST_OPTIONS


@pytest.mark.parametrize("columns", [80, 52])
def test_help_names_every_command_and_fits_the_terminal(columns: int) -> None:
    """No line of the help is wider than the terminal, no word is cut, and the last line says how to start."""
    text = _python("from labrig.cli.main import run_command; run_command(['--help'])", columns)
    listed = {line.split()[0] for line in text.partition("Commands:")[2].splitlines() if line.strip()}
    assert {name.split()[0] for name in COMMANDS} <= listed
    assert max(len(line) for line in text.splitlines()) <= columns
    assert "labrig run steerability" in " ".join(text.split())


@pytest.mark.parametrize("name", COMMANDS)
def test_help_of_a_command_names_its_options(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Each option stands whole in the help, which exits with 0."""
    assert run_command([*name.split(), "--help"]) == 0
    words = capsys.readouterr().out.replace(",", " ").split()
    assert [
        opt for param in COMMANDS[name].params for opt in param.opts if opt[0] == "-" and opt not in words
    ] == []


@pytest.mark.parametrize(
    ("arguments", "unneeded"),
    [
        (["--help"], HEAVY),
        (["manual"], tuple(set(HEAVY) - {"pydantic"})),
        (["runs"], tuple(set(HEAVY) - {"pydantic"})),
        (["check", str(SWEEP), "--rig", str(RIG)], ("matplotlib", "jinja2", "rerun")),
    ],
)
def test_help_and_lists_load_no_heavy_package(arguments: list[str], unneeded: tuple[str, ...]) -> None:
    """Help and lists import no numpy, OpenCV or pandas; a check draws nothing."""
    code = (
        "import sys, os, io, contextlib, json\n"
        "os.environ['LABRIG_RUNS_DIR'] = 'none'\n"
        "from labrig.cli.main import run_command\n"
        f"with contextlib.redirect_stdout(io.StringIO()): run_command({arguments!r})\n"
        f"print(json.dumps([name for name in {unneeded!r} if name in sys.modules]))"
    )
    assert json.loads(_python(code)) == []


def test_json_is_of_one_command_alone(capsys: pytest.CaptureFixture[str]) -> None:
    """What the same process prints afterwards is text again."""
    assert run_command(["rusn", "--json"]) == 2
    json.loads(capsys.readouterr().out)
    print_line("text")
    assert capsys.readouterr().out == "text\n"
