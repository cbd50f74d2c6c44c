"""A lab folder in which the blocks of a page run, in order."""

import contextlib
import io
import os
import re
import shlex
import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from labrig.cli.main import run_command
from tests.manual.pages import Fence, Line, list_lines

_FOR_A_SHELL = re.compile(r"[|<>;&$*?`]")


def make_lab_folder(folder: Path) -> Path:
    """Return a new lab folder."""
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        assert run_command(["init", str(folder)]) == 0
    return folder


@dataclass
class Lab:
    """The working folder of this process, and the names that the Python of a page has defined."""

    names: dict[str, Any] = field(default_factory=lambda: {"__name__": "__main__"})

    def run(self, block: Fence) -> None:
        """Run a block as it stands; fail with its page's line if it ends otherwise than it says."""
        if block.info == "python":
            with contextlib.redirect_stdout(io.StringIO()):
                exec(compile(block.text, f"block at line {block.line}", "exec"), self.names)
            return
        for line in list_lines(block):
            exit_code, said = _run_line(line.command)
            assert (line.command, exit_code) == (line.command, line.exit_code), said


def _run_line(command: str) -> tuple[int, str]:
    """Run a line: a plain labrig in this process, which is faster, anything else by a shell."""
    words = shlex.split(command, comments=True)
    unquoted = re.sub(r"'[^']*'|\"[^\"]*\"", "", command.partition(" #")[0])
    if words[0] == "labrig" and not _FOR_A_SHELL.search(unquoted):
        said = io.StringIO()
        with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
            exit_code = run_command(words[1:])
        return exit_code, said.getvalue()
    done = run_shell(command, Path())
    return done.returncode, done.stdout + done.stderr


def run_shell(script: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """Run a script by bash, with the labrig of this environment."""
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    return subprocess.run(
        ["bash", "-c", script], cwd=folder, env={**os.environ, "PATH": path}, stdin=subprocess.DEVNULL,
        capture_output=True, text=True, check=False, timeout=300,
    )  # fmt: skip


def run_script(lines: list[Line], folder: Path) -> None:
    """Run lines in order by one bash, beginning in a folder; each must end as it says, and a `cd` lasts."""
    checked = [
        f"{line.command}\n(exit $?) ; code=$?; [ $code -eq {line.exit_code} ] || "
        f"{{ echo {shlex.quote(line.command)} ended with $code >&2; exit 99; }}"
        for line in lines
    ]
    done = run_shell("\n".join(checked), folder)
    assert done.returncode == 0, done.stdout + done.stderr
