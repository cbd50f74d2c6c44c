"""Output on a terminal: lines wrapped to its width between words, and no control characters from data."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.cli.conftest import RIG, ROOT, SWEEP, Labrig

pytestmark = pytest.mark.slow

HOSTILE = "gel \x1b[2J\x1b]0;owned\x07 was \x9b31mcloudy\u202e <b>"


def _at_terminal(columns: int, *arguments: object) -> list[str]:
    """Return the lines that a command prints on a terminal of a given width."""
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
    """Return the output so far; empty after the end of the program, which Linux reports as an error."""
    try:
        return os.read(screen, 4096)
    except OSError:
        return b""


def _show(code: str, columns: int) -> str:
    """Return all that a Python prints on a terminal of a given width, with what moves the cursor."""
    screen, program = os.openpty()
    environment = {**os.environ, "COLUMNS": str(columns), "TERM": "xterm"}
    command = [sys.executable, "-c", code]
    with subprocess.Popen(command, stdout=program, stderr=program, env=environment) as running:
        os.close(program)
        shown = b"".join(iter(lambda: _read(screen), b"")).decode()
        assert running.wait(timeout=30) == 0
    os.close(screen)
    return shown


PROGRESS = """
from labrig.cli.output import say
from labrig.cli.progress import hold_bar, progress
with progress('steerability', 100.0) as reporter:
    reporter(50.0, 'gel 10 %, insertion 3 of 18, withdrawing the needle from the gel, ' * 2)
    with hold_bar():
        say('which hole?')
        say('the answer')
print('result')
"""


@pytest.mark.parametrize("columns", [20, 40, 80])
def test_the_bar_is_gone_while_a_question_is_asked_and_comes_back(columns: int) -> None:
    """Its line is erased before the question, drawn again after the answer, and stays; bar and times stay whole."""
    before, _, rest = _show(PROGRESS, columns).partition("which hole?\r\nthe answer\r\n")
    assert re.fullmatch(r"\r?\x1b\[1A\x1b\[2K", before.rpartition("\n")[2].replace("\x1b[?25h", ""))
    bar, _, result = rest.rpartition("\n")[0].rpartition("\n")
    shown = re.sub(r"\x1b\[[0-9;?]*\w", "", bar.rpartition("\x1b[2K")[2])
    assert " 50 %" in shown
    if columns == 80:
        assert re.search(
            r" 50 % \S{12,} \d:\d\d:\d\d left [-\d]:[-\d]+:[-\d]+ gel 10 %, insertion 3 .*…", shown
        )
    assert re.sub(r"\x1b\[\?25h|\r", "", result) == "result"


def test_work_of_unknown_length_is_shown_and_removed() -> None:
    """A terminal shows what labrig is at; nothing of it is left, and nothing comes without a terminal."""
    code = (
        "import sys, threading\n"
        "from labrig.cli.progress import show_working\n"
        "with show_working('finding the lines'): threading.Event().wait(0.3)\n"
        "sys.stderr.write('done')\n"
    )
    shown = _show(code, 80)
    assert "finding the lines" in shown
    assert shown.endswith(("\x1b[2Kdone", "\x1b[?25hdone"))
    elsewhere = subprocess.run([sys.executable, "-c", code], capture_output=True, check=True)
    assert elsewhere.stderr == b"done"


def _words_too_long(lines: list[str], columns: int) -> list[str]:
    return [line for line in lines if len(line) > columns and len(line.split()) > 1]


@pytest.mark.parametrize("columns", [40, 80])
def test_what_cannot_run_is_folded_between_words(columns: int, tmp_path: Path) -> None:
    """`labrig check` prints no line wider than the terminal, and indents the further lines of a problem."""
    lines = _at_terminal(columns, "check", SWEEP, "--rig", RIG, "--set", "insertion.length_mm=500")
    assert _words_too_long(lines, columns) == []
    assert " ".join(" ".join(lines).split()).count("cannot run on rig simulated") == 1
    first = next(number for number, line in enumerate(lines) if "axes.insertion" in line)
    assert lines[first + 1].startswith("  ")


@pytest.fixture
def shelf(tmp_path: Path, labrig: Labrig) -> Path:
    """Two runs, one of which has tags and a verdict."""
    for name in ("20261121-091022-steerability", "run with spaces, \u00e9"):
        shutil.copytree(ROOT / "tests" / "records" / "steerability", tmp_path / name)
    run = tmp_path / "20261121-091022-steerability"
    labrig("runs", "annotate", run, "--tag", "pilot", "--tag", "a tag of several words")
    labrig("runs", "annotate", run, "--note", HOSTILE)
    labrig("runs", "annotate", run, "--verdict", "doubtful")
    return tmp_path


@pytest.mark.parametrize("columns", [80, 40])
def test_the_list_of_runs_fits(shelf: Path, columns: int) -> None:
    """The list shows whole names, tags and verdicts within the width of the terminal."""
    lines = _at_terminal(columns, "runs", "--runs-dir", shelf)
    words = {"20261121-091022-steerability", "doubtful", "pilot"}
    assert ({word for word in words if word in "\n".join(lines)}, max(map(len, lines)) <= columns) == (
        words,
        True,
    )


def test_what_others_wrote_does_not_speak_to_the_terminal(shelf: Path, labrig: Labrig) -> None:
    """Escape sequences in a note are printed as text; in JSON they are escaped and parse back."""
    run = shelf / "20261121-091022-steerability"
    printed = "\n".join(_at_terminal(200, "runs", "show", run))
    done = labrig("runs", "show", run, "--json")
    assert ("cloudy" in printed, "\\x1b[2J" in printed) == (True, True)
    assert not set(printed + done.out) & set("\x1b\x07\x9b\u202e")
    assert done.json()["notes"][0]["text"] == HOSTILE


def test_a_name_that_is_no_utf_8_is_listed(tmp_path: Path, labrig: Labrig) -> None:
    """A file name that is not UTF-8 is listed with its bytes escaped, also in JSON."""
    name = os.fsdecode(b"run-\xff")
    shutil.copytree(ROOT / "tests" / "records" / "steerability", tmp_path / name)
    assert "run-\\udcff" in labrig("runs", "--runs-dir", tmp_path).out
    assert labrig("runs", "--runs-dir", tmp_path, "--json").json()[0]["run"].endswith(name)
