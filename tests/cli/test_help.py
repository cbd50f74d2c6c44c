"""What `labrig --help` prints, and what it does not import."""

import json
import os
import subprocess
import sys

import pytest

from tests.cli.conftest import RIG, SWEEP

COMMANDS = (
    "run",
    "pause",
    "continue",
    "check",
    "reanalyze",
    "import",
    "report",
    "view",
    "runs",
    "schema",
    "calibrate",
    "measure",
    "devices",
)
HEAVY = (
    "numpy",
    "cv2",
    "pandas",
    "scipy",
    "matplotlib",
    "rerun",
    "can",
    "canopen",
    "ruamel",
    "labrig.experiments",
)


def _python(code: str, columns: int = 80) -> str:
    environment = {**os.environ, "COLUMNS": str(columns), "NO_COLOR": "1", "TERM": "dumb"}
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, env=environment, timeout=60
    )
    return done.stdout


def test_help_names_every_command() -> None:
    """It lists the stable commands."""
    text = _python("from labrig.cli.main import run_command; run_command(['--help'])")
    assert [command for command in COMMANDS if f" {command} " not in text] == []


@pytest.mark.parametrize("columns", [80, 40])
def test_help_fits_the_terminal(columns: int) -> None:
    """No line of the help is wider than the terminal, no word is cut, and the last line says how to start."""
    text = _python("from labrig.cli.main import run_command; run_command(['--help'])", columns)
    assert max(len(line) for line in text.splitlines()) <= columns
    assert "…" not in text
    assert "labrig run steerability" in text


@pytest.mark.parametrize("columns", [80, 40])
@pytest.mark.parametrize("command", ["calibrate plane", "design", "runs"])
def test_no_name_is_cut(command: str, columns: int) -> None:
    """The name of every option stands whole in the help, in lines that fit the terminal."""
    arguments = [*command.split(), "--help"]
    code = (
        "import typer\nfrom labrig.cli.main import _make_app, run_command\n"
        f"named = typer.main.get_command(_make_app({arguments!r}))\n"
        f"for name in {command.split()!r}: named = named.commands[name]\n"
        "print(*(name for param in named.params for name in param.opts))\n"
        f"run_command({arguments!r})"
    )
    names, *lines = _python(code, columns).splitlines()
    words = " ".join(lines).split()
    assert len(names.split()) > 3
    assert [name for name in names.split() if name.startswith("--") and name not in words] == []
    assert max(len(line) for line in lines) <= columns


@pytest.mark.parametrize(
    ("arguments", "unneeded"),
    [
        (["--help"], (*HEAVY, "pydantic", "rich.markdown", "rich.traceback")),
        (["runs"], (*HEAVY, "pydantic")),
        (["runs", "--where", "seed=1"], ("numpy", "cv2", "pandas", "pydantic", "importlib.metadata")),
        (["check", str(SWEEP), "--rig", str(RIG)], ("scipy.stats", "matplotlib", "jinja2", "rerun")),
        (["manual"], (*HEAVY, "pydantic")),
    ],
)
def test_help_and_lists_load_no_heavy_package(arguments: list[str], unneeded: tuple[str, ...]) -> None:
    """Help and lists import no numpy, OpenCV or pandas, help no more than it shows; a check draws nothing."""
    code = (
        "import sys, os, io, contextlib, json\n"
        "os.environ['LABRIG_RUNS_DIR'] = 'none'\n"
        "from labrig.cli.main import run_command\n"
        f"with contextlib.redirect_stdout(io.StringIO()): run_command({arguments!r})\n"
        f"print(json.dumps([name for name in {unneeded!r} if name in sys.modules]))"
    )
    assert json.loads(_python(code)) == []


def test_markdown_is_shown_after_help() -> None:
    """What help does not import can be imported after it in the same process."""
    shown = _python(
        "from labrig.cli.main import run_command\n"
        "for words in (['--help'], ['manual', 'units', '--print']): run_command(words)"
    )
    assert "Units, frames and signs" in shown
