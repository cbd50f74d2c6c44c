"""Standard streams, terminals and signals: never a traceback, never a lost run, never a line too wide."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import pytest

from labrig.cli.signals import Interruption, raise_on_signals
from labrig.errors import BugError
from tests.cli.conftest import RIG, ROOT, SWEEP, Labrig
from tests.cli.example_runs import of_protocol

LABRIG = f'"{sys.executable}" -m labrig'
_WITHOUT = "import sys; sys.modules['{}'] = None; from labrig.cli.start import main; main()"


def _shell(command: str, **environment: str) -> subprocess.CompletedProcess[str]:
    words, around = ["bash", "-c", command], {**os.environ, **environment}
    return subprocess.run(words, capture_output=True, text=True, check=False, timeout=300, env=around)


@pytest.mark.parametrize(
    ("module", "redirection"),
    [
        ("labrig.errors", ""), ("labrig.cli.signals", ""), ("labrig.cli.main", ""), ("typer", ""),
        ("typer", ">/dev/full"), ("typer", "2>&-"),
    ],
)  # fmt: skip
def test_an_import_that_fails_at_the_start_is_reported_as_a_bug(
    module: str, redirection: str, tmp_path: Path
) -> None:
    """Code 5, a sentence, a document under --json where that can be told, and the traceback in the named file."""
    done = _shell(
        f"'{sys.executable}' -c \"{_WITHOUT.format(module)}\" runs --json {redirection}", TMPDIR=str(tmp_path)
    )
    (file,) = tmp_path.iterdir()
    first, *rest = file.read_text(encoding="utf-8").splitlines()
    told = (done.returncode, "runs --json" in first, any(line.startswith("Traceback (most") for line in rest))
    assert told == (BugError.exit_code, True, True)
    if not redirection:
        error = json.loads(done.stdout)["error"]
        assert (error["type"], module in error["message"]) == (BugError.__name__, True)
        assert error["hint"] == f"please report it, with the traceback in {file}"
        assert done.stderr.startswith("error: labrig itself failed: ")


@pytest.mark.parametrize(
    ("command", "exit_code", "error"),
    [("design --help >&-", 0, ""), ("manual | true", 0, ""), ("manual >/dev/full", 3, "error: ")],
)
def test_a_standard_output_that_is_closed_unread_or_full_is_told_in_a_line(
    command: str, exit_code: int, error: str
) -> None:
    """Where nobody reads on, or it was closed, that is no error; a full device is, without a traceback."""
    done = _shell(f"{LABRIG} {command}; exit ${{PIPESTATUS[0]}}")
    told = (done.returncode, done.stderr.startswith(error), bool(done.stderr))
    assert told == (exit_code, True, bool(error))
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize("ending", [pytest.param("2>&-", marks=pytest.mark.slow), "2> >(exec true)"])
def test_progress_that_nobody_can_be_told_does_not_end_a_run(ending: str, tmp_path: Path) -> None:
    """Whether standard error was closed from the start or its reader goes away, the run succeeds."""
    settings = " ".join(f"'{word}'" for word in of_protocol("steerability"))
    done = _shell(f"{LABRIG} run {settings} --runs-dir '{tmp_path}' --json {ending}")
    assert (done.returncode, json.loads(done.stdout)["exit_status"]) == (0, "success")


def test_ctrl_c_is_taken_before_anything_is_imported() -> None:
    """Ctrl+C right after the start prints no traceback, because the signal handler is set before any import."""
    code = "import sys, labrig.cli.start; print([m for m in sys.modules if m.startswith('labrig.cli.')])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "['labrig.cli.start']"


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_passes_through_libraries_that_catch_everything(number: signal.Signals) -> None:
    """A signal is not an Exception, so that a library that catches all exceptions cannot swallow it."""
    with raise_on_signals(), pytest.raises(Interruption, match=number.name), suppress(Exception):
        os.kill(os.getpid(), number)


_INTERRUPTED_FORK = """
import os, signal
from threading import Thread
from labrig.analysis.engine import open_process_pool, run_in_order
from labrig.cli.signals import Interruption, raise_on_signals

def interrupt():
    thread = Thread(target=signal.raise_signal, args=(signal.SIGINT,))
    thread.start()
    thread.join()

os.register_at_fork({when}=interrupt)
try:
    with raise_on_signals(), open_process_pool(1, "counted") as pool:
        list(run_in_order(pool, abs, [-1]))
except Interruption as interruption:
    print(interruption)
"""


@pytest.mark.parametrize("when", ["before", "after_in_parent"])
def test_a_signal_while_a_worker_is_forked_is_not_dropped(when: str) -> None:
    """Python drops what a handler raises in a hook of a fork, in whichever thread the signal arrived."""
    code = _INTERRUPTED_FORK.format(when=when)
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=300
    )
    assert (done.stdout, done.stderr) == ("SIGINT\n", "")


NO_UTF_8 = os.fsdecode(b"run-\xff")
HOSTILE = "gel \x1b[2J\x1b]0;owned\x07 was \x9b31mcloudy\u202e <b>"


def _show(columns: int, code: str, term: str = "xterm") -> str:
    """Return all that a Python prints on a terminal of a given width, with what moves the cursor."""
    screen, program = os.openpty()
    environment = {**os.environ, "COLUMNS": str(columns), "TERM": term}
    words = [sys.executable, "-c", code]
    with subprocess.Popen(words, stdout=program, stderr=program, env=environment) as running:
        os.close(program)
        shown = b"".join(iter(lambda: _read(screen), b"")).decode()
        running.wait(timeout=300)
    os.close(screen)
    return shown


def _read(screen: int) -> bytes:
    """Return the output so far; empty after the end of the program, which Linux reports as an error."""
    try:
        return os.read(screen, 4096)
    except OSError:
        return b""


PROGRESS = """
from labrig.cli.output import say
from labrig.cli.progress import hold_bar, progress
with progress('steerability', 100.0, 60.0) as reporter:
    reporter(50.0, 'gel 10 %, insertion 3 of 18, withdrawing the needle from the gel, ' * 2)
    with hold_bar():
        say('which hole?')
        say('the answer')
print('result')
"""


@pytest.mark.slow
@pytest.mark.parametrize("columns", [20, 40, 80])
def test_the_bar_is_gone_while_a_question_is_asked_and_comes_back(columns: int) -> None:
    """Its line is erased before the question, drawn again after the answer, and stays; bar and times stay whole."""
    before, _, rest = _show(columns, PROGRESS).partition("which hole?\r\nthe answer\r\n")
    assert re.fullmatch(r"\r?\x1b\[1A\x1b\[2K", before.rpartition("\n")[2].replace("\x1b[?25h", ""))
    bar, _, result = rest.rpartition("\n")[0].rpartition("\n")
    shown = re.sub(r"\x1b\[[0-9;?]*\w", "", bar.rpartition("\x1b[2K")[2])
    assert " 50 %" in shown
    if columns == 80:
        line = r" 50 % \S{12,} \d:\d\d:\d\d left 0:0(1:00|0:5\d) gel 10 %, insertion 3 .*…"
        assert re.search(line, shown)
    assert re.sub(r"\x1b\[\?25h|\r", "", result) == "result"


@pytest.mark.slow
@pytest.mark.parametrize("columns", [40, 80])
def test_what_is_printed_fits_the_terminal(columns: int, tmp_path: Path) -> None:
    """Problems are folded between words and indented; the list has whole names, tags and verdicts."""
    run = str(
        shutil.copytree(ROOT / "tests" / "records" / "import", tmp_path / "20261121-091022-steerability")
    )
    listing = (
        [
            "runs", "annotate", run, "--tag", "pilot", "--tag", "a tag of several words", "--verdict",
            "doubtful",
        ],
        ["runs", "--runs-dir", str(tmp_path)],
    )  # fmt: skip
    checking = (["check", str(SWEEP), "--rig", str(RIG), "--set", "insertion.length_mm=500"],)
    code = "from labrig.cli.main import run_command\nfor words in {!r}: run_command(words)"
    listed, checked = (_show(columns, code.format(words), "dumb") for words in (listing, checking))
    assert {"20261121-091022-steerability", "doubtful", "pilot"} <= set(re.split(r"[\s,]+", listed))
    assert max(map(len, listed.splitlines()[1:])) <= columns
    assert [line for line in checked.splitlines() if len(line) > columns and len(line.split()) > 1] == []
    assert " ".join(checked.split()).count("cannot run on rig simulated") == 1
    assert "of motion" not in checked
    assert re.search(r"axes\.insertion.*\n  ", checked)


def test_what_others_wrote_does_not_speak_to_the_terminal(labrig: Labrig, tmp_path: Path) -> None:
    """Escape sequences and names that are no UTF-8 are printed as text, and parse back from JSON."""
    run = tmp_path / NO_UTF_8
    shutil.copytree(ROOT / "tests" / "records" / "import", run)
    labrig("runs", "annotate", run, "--note", HOSTILE)
    printed, done = labrig("runs", "show", run).out, labrig("runs", "show", run, "--json")
    assert ("cloudy" in printed, "\\x1b[2J" in printed) == (True, True)
    assert not set(printed + done.out) & set("\x1b\x07\x9b\u202e")
    assert done.json()["notes"][0]["text"] == HOSTILE
    listed = labrig("runs", "--runs-dir", tmp_path), labrig("runs", "--runs-dir", tmp_path, "--json")
    assert "run-\\udcff" in listed[0].out
    assert Path(listed[1].json()[0]["run"]).name == NO_UTF_8
