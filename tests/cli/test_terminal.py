"""What a terminal is given: lines that fit it, and no control character that somebody else wrote."""

import fcntl
import os
import pty
import shutil
import struct
import subprocess
import sys
import termios
from pathlib import Path

import pytest

from labrig.cli.output import plain
from tests.cli.conftest import ROOT, Labrig

HOSTILE = "gel \x1b[2J\x1b]0;owned\x07 was \x9b31mcloudy\u202e <b>"


@pytest.fixture
def shelf(tmp_path: Path, labrig: Labrig) -> Path:
    """Two runs, one of which has been called names."""
    for name in ("20261121-091022-steerability", "run with spaces, \u00e9"):
        shutil.copytree(ROOT / "data" / "first-record", tmp_path / name)
    run = tmp_path / "20261121-091022-steerability"
    labrig("runs", "tag", run, "-t", "pilot", "-t", "a tag of several words")
    labrig("runs", "note", run, HOSTILE)
    labrig("runs", "verdict", run, "doubtful", "--reason", HOSTILE)
    return tmp_path


def _on_a_terminal(columns: int, *arguments: str) -> str:
    """Return what labrig writes to a terminal of that width."""
    ours, its = pty.openpty()
    fcntl.ioctl(its, termios.TIOCSWINSZ, struct.pack("HHHH", 24, columns, 0, 0))
    own = {name: value for name, value in os.environ.items() if name not in {"COLUMNS", "LINES"}}
    command = [sys.executable, "-m", "labrig", *arguments]
    with subprocess.Popen(command, stdout=its, stderr=its, cwd=ROOT, env=own):
        os.close(its)
        parts = []
        while part := _read(ours):
            parts.append(part)
    os.close(ours)
    return b"".join(parts).decode()


def _read(descriptor: int) -> bytes:
    try:
        return os.read(descriptor, 4096)
    except OSError:  # the other end has closed the terminal
        return b""


@pytest.mark.parametrize("columns", [80, 40])
def test_the_list_of_runs_fits(shelf: Path, columns: int) -> None:
    """Names are whole, tags and verdict are there, and no line is wider than the terminal."""
    listed = _on_a_terminal(columns, "runs", "--runs-dir", str(shelf))
    assert "20261121-091022-steerability" in listed
    assert "doubtful" in listed
    assert "pilot" in listed
    assert max(len(line.rstrip()) for line in listed.splitlines()) <= columns


def test_what_others_wrote_does_not_speak_to_the_terminal(shelf: Path) -> None:
    """Escape sequences of a note, asked for by a condition or printed whole, are written out."""
    run = str(shelf / "20261121-091022-steerability")
    for arguments in (("runs", "note", run), ("runs", "--runs-dir", str(shelf), "--where", "note~gel")):
        printed = _on_a_terminal(200, *arguments)
        assert "cloudy" in printed
        assert not set(printed) & set("\x1b\x07\x9b\u202e")
        assert "\\x1b[2J" in printed


def test_json_keeps_what_was_written_and_holds_no_control_character(shelf: Path, labrig: Labrig) -> None:
    """The document reads back as the note was, with every control character escaped."""
    done = labrig("runs", "note", shelf / "20261121-091022-steerability", "--json")
    assert done.json()["notes"][0]["text"] == HOSTILE
    assert not set(done.out) & set("\x1b\x07\x9b\u202e")


def test_a_name_that_is_no_utf_8_is_listed(tmp_path: Path, labrig: Labrig) -> None:
    """Half a character is written out, in the list and in JSON."""
    name = os.fsdecode(b"run-\xff")
    shutil.copytree(ROOT / "data" / "first-record", tmp_path / name)
    assert "run-\\udcff" in labrig("runs", "--runs-dir", tmp_path).out
    assert labrig("runs", "--runs-dir", tmp_path, "--json").json()[0]["run"].endswith(name)


def test_letters_of_any_language_and_line_ends_stay() -> None:
    """Only what controls a terminal is written out."""
    assert plain("Gel gr\u00fcn\t\u6c34\nzwei") == "Gel gr\u00fcn\t\u6c34\nzwei"
