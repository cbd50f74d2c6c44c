"""What a terminal shows: lines that fit it, folded between words."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.cli.conftest import RIG, SWEEP

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="pseudo-terminals are POSIX's")


def _at_terminal(columns: int, *arguments: object) -> list[str]:
    """Return the lines that a command prints on a terminal of so many columns."""
    screen, program = os.openpty()
    command = [sys.executable, "-m", "labrig", *map(str, arguments)]
    environment = {**os.environ, "COLUMNS": str(columns), "TERM": "dumb"}
    with subprocess.Popen(command, stdout=program, stderr=subprocess.PIPE, env=environment) as running:
        os.close(program)
        shown = b"".join(iter(lambda: _read(screen), b""))
        assert running.stderr is not None
        assert running.stderr.read() == b""
    os.close(screen)
    return shown.decode().replace("\r\n", "\n").splitlines()


def _read(screen: int) -> bytes:
    """Return what has been printed; nothing once the program has ended, which Linux tells by an error."""
    try:
        return os.read(screen, 4096)
    except OSError:
        return b""


def _words_too_long(lines: list[str], columns: int) -> list[str]:
    return [line for line in lines if len(line) > columns and len(line.split()) > 1]


@pytest.mark.parametrize("columns", [40, 80])
def test_what_cannot_run_is_folded_between_words(columns: int, tmp_path: Path) -> None:
    """No line of `labrig check` is wider than the terminal, and further lines of a problem stand further in."""
    lines = _at_terminal(columns, "check", SWEEP, "--rig", RIG, "--set", "insertion.length_mm=500")
    assert _words_too_long(lines, columns) == []
    assert " ".join(" ".join(lines).split()).count("cannot run on rig simulated") == 1
    first = next(number for number, line in enumerate(lines) if "insertion.length_mm" in line)
    assert lines[first + 1].startswith("  ")


def test_the_rig_is_checked_on_a_narrow_terminal() -> None:
    """`labrig devices check` at 40 columns."""
    lines = _at_terminal(40, "devices", "check", "--rig", RIG)
    assert _words_too_long(lines, 40) == []
    assert any(line.startswith("PASS  bus") for line in lines)
