"""Standard streams, terminals and signals: never a traceback, never a lost run, never a line too wide."""

import io
import json
import os
import re
import shutil
import signal
import subprocess
import sys
from contextlib import redirect_stderr, suppress
from pathlib import Path

import pytest

from labrig.cli.output import say
from labrig.cli.signals import Interruption, raise_on_signals
from labrig.errors import BugError
from labrig.posix import hold_signals
from tests.cli.conftest import RIG, ROOT, SWEEP, Labrig
from tests.cli.example_runs import of_protocol

LABRIG = f'"{sys.executable}" -m labrig'
_WITHOUT = "import sys; sys.modules['{}'] = None; from labrig.cli.start import main; main()"


def _shell(command: str, **environment: str) -> subprocess.CompletedProcess[str]:
    words, around = ["bash", "-c", command], {**os.environ, **environment}
    return subprocess.run(words, capture_output=True, text=True, check=False, timeout=300, env=around)


def _start_without(module: str, folder: Path, words: str) -> tuple[subprocess.CompletedProcess[str], Path]:
    """Run a command line that cannot import this module; return its process, and its one temporary file."""
    done = _shell(f"'{sys.executable}' -c \"{_WITHOUT.format(module)}\" {words}", TMPDIR=str(folder))
    (file,) = folder.iterdir()
    return done, file


@pytest.mark.parametrize("module", ["typer", "labrig.errors", "labrig.cli.signals", "labrig.cli.main"])
def test_an_import_that_fails_at_the_start_is_reported_as_a_bug(module: str, tmp_path: Path) -> None:
    """It exits with 5, prints one sentence and a hint, and leaves its traceback in the named file."""
    done, file = _start_without(module, tmp_path, "--version")
    assert (done.returncode, done.stdout) == (BugError.exit_code, "")
    sentence, hint = done.stderr.splitlines()
    assert (sentence.startswith("error: labrig itself failed: "), module in sentence) == (True, True)
    assert hint == f"hint: please report it, with the traceback in {file}"
    text = file.read_text(encoding="utf-8")
    assert ("--version" in text.splitlines()[0], module in text, "Traceback (most" in text) == (
        True,
        True,
        True,
    )


@pytest.mark.parametrize("redirection", ["", ">/dev/full", "2>&-"])
def test_a_failed_import_keeps_its_exit_code_where_nobody_can_be_told(
    redirection: str, tmp_path: Path
) -> None:
    """A stream that is full or closed changes neither code nor file; with --json the error is a document."""
    done, file = _start_without("typer", tmp_path, f"runs --json {redirection}")
    assert done.returncode == BugError.exit_code
    if not redirection:
        error = json.loads(done.stdout)["error"]
        told = (error["type"], "typer" in error["message"], error["hint"].endswith(str(file)))
        assert told == (BugError.__name__, True, True)


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


@pytest.mark.parametrize("ending", ["2>&-", "2> >(exec true)"])
def test_progress_that_nobody_can_be_told_does_not_end_a_run(ending: str, tmp_path: Path) -> None:
    """Whether standard error was closed from the start or its reader goes away, the run succeeds."""
    settings = " ".join(f"'{word}'" for word in of_protocol("steerability"))
    done = _shell(f"{LABRIG} run {settings} --runs-dir '{tmp_path}' --json {ending}")
    assert done.returncode == 0
    assert json.loads(done.stdout)["exit_status"] == "success"


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


class InterruptedStream(io.StringIO):
    """A stream that a signal interrupts in its second flush."""

    flushes = 0

    def flush(self) -> None:
        """Flush."""
        self.flushes += 1
        if self.flushes == 2:
            signal.raise_signal(signal.SIGINT)


def test_a_signal_between_two_messages_is_not_dropped() -> None:
    """A message leaves no flush to a finaliser, in which Python drops a signal: the next one is the next message's."""

    with (
        redirect_stderr(InterruptedStream()),
        raise_on_signals(),
        pytest.raises(Interruption, match="SIGINT"),
    ):
        _say_both()


def _say_both() -> None:
    say("one")
    say("two")


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


def test_held_signals_come_after_the_block() -> None:
    """Signals during a block that holds them raise nothing in it, and the first of them raises at its end."""
    reached = []

    def work() -> None:
        with hold_signals():
            signal.raise_signal(signal.SIGTERM)
            signal.raise_signal(signal.SIGINT)
            reached.append("end of the block")

    with raise_on_signals():
        with pytest.raises(Interruption, match="SIGTERM"):
            work()
        with pytest.raises(Interruption, match="SIGINT"):
            signal.raise_signal(signal.SIGINT)
    assert reached == ["end of the block"]


NO_UTF_8 = os.fsdecode(b"run-\xff")
HOSTILE = "gel \x1b[2J\x1b]0;owned\x07 was \x9b31mcloudy\u202e <b>"


def _show(columns: int, *command: object, term: str = "xterm") -> str:
    """Return all that a Python prints on a terminal of a given width, with what moves the cursor."""
    screen, program = os.openpty()
    environment = {**os.environ, "COLUMNS": str(columns), "TERM": term}
    words = [sys.executable, *map(str, command)]
    with subprocess.Popen(words, stdout=program, stderr=program, env=environment) as running:
        os.close(program)
        shown = b"".join(iter(lambda: _read(screen), b"")).decode()
        running.wait(timeout=300)
    os.close(screen)
    return shown


def _list_lines(columns: int, *arguments: object) -> list[str]:
    """Return the lines that a labrig prints on a terminal of a given width."""
    return _show(columns, "-m", "labrig", *arguments, term="dumb").replace("\r\n", "\n").splitlines()


def _read(screen: int) -> bytes:
    """Return the output so far; empty after the end of the program, which Linux reports as an error."""
    try:
        return os.read(screen, 4096)
    except OSError:
        return b""


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


@pytest.mark.slow
@pytest.mark.parametrize("columns", [20, 40, 80])
def test_the_bar_is_gone_while_a_question_is_asked_and_comes_back(columns: int) -> None:
    """Its line is erased before the question, drawn again after the answer, and stays; bar and times stay whole."""
    before, _, rest = _show(columns, "-c", PROGRESS).partition("which hole?\r\nthe answer\r\n")
    assert re.fullmatch(r"\r?\x1b\[1A\x1b\[2K", before.rpartition("\n")[2].replace("\x1b[?25h", ""))
    bar, _, result = rest.rpartition("\n")[0].rpartition("\n")
    shown = re.sub(r"\x1b\[[0-9;?]*\w", "", bar.rpartition("\x1b[2K")[2])
    assert " 50 %" in shown
    if columns == 80:
        assert re.search(
            r" 50 % \S{12,} \d:\d\d:\d\d left [-\d]:[-\d]+:[-\d]+ gel 10 %, insertion 3 .*…", shown
        )
    assert re.sub(r"\x1b\[\?25h|\r", "", result) == "result"


@pytest.mark.slow
def test_work_of_unknown_length_is_shown_and_removed() -> None:
    """A terminal shows what labrig is at; nothing of it is left, and nothing comes without a terminal."""
    code = (
        "import sys, threading\n"
        "from labrig.cli.progress import show_working\n"
        "with show_working('finding the lines'): threading.Event().wait(0.3)\n"
        "sys.stderr.write('done')\n"
    )
    shown = _show(80, "-c", code)
    assert "finding the lines" in shown
    assert shown.endswith(("\x1b[2Kdone", "\x1b[?25hdone"))
    elsewhere = subprocess.run([sys.executable, "-c", code], capture_output=True, check=True)
    assert elsewhere.stderr == b"done"


@pytest.mark.slow
@pytest.mark.parametrize("columns", [40, 80])
def test_what_cannot_run_is_folded_between_words(columns: int, tmp_path: Path) -> None:
    """`labrig check` prints no line wider than the terminal, and indents the further lines of a problem."""
    lines = _list_lines(columns, "check", SWEEP, "--rig", RIG, "--set", "insertion.length_mm=500")
    assert [line for line in lines if len(line) > columns and len(line.split()) > 1] == []
    assert " ".join(" ".join(lines).split()).count("cannot run on rig simulated") == 1
    first = next(number for number, line in enumerate(lines) if "axes.insertion" in line)
    assert lines[first + 1].startswith("  ")


@pytest.fixture
def shelf(tmp_path: Path, labrig: Labrig) -> Path:
    """Two runs, one of which has tags and a verdict."""
    for name in ("20261121-091022-steerability", NO_UTF_8):
        shutil.copytree(ROOT / "tests" / "records" / "steerability", tmp_path / name)
    run = tmp_path / "20261121-091022-steerability"
    labrig("runs", "annotate", run, "--tag", "pilot", "--tag", "a tag of several words")
    labrig("runs", "annotate", run, "--note", HOSTILE)
    labrig("runs", "annotate", run, "--verdict", "doubtful")
    return tmp_path


@pytest.mark.slow
@pytest.mark.parametrize("columns", [80, 40])
def test_the_list_of_runs_fits(shelf: Path, columns: int) -> None:
    """The list shows whole names, tags and verdicts within the width of the terminal."""
    lines = _list_lines(columns, "runs", "--runs-dir", shelf)
    words = ("20261121-091022-steerability", "doubtful", "pilot")
    assert [word for word in words if word not in "\n".join(lines)] == []
    assert max(map(len, lines)) <= columns


@pytest.mark.slow
def test_what_others_wrote_does_not_speak_to_the_terminal(shelf: Path, labrig: Labrig) -> None:
    """Escape sequences in a note are printed as text; in JSON they are escaped and parse back."""
    run = shelf / "20261121-091022-steerability"
    printed = "\n".join(_list_lines(200, "runs", "show", run))
    done = labrig("runs", "show", run, "--json")
    assert ("cloudy" in printed, "\\x1b[2J" in printed) == (True, True)
    assert not set(printed + done.out) & set("\x1b\x07\x9b\u202e")
    assert done.json()["notes"][0]["text"] == HOSTILE


@pytest.mark.slow
def test_a_name_that_is_no_utf_8_is_listed(shelf: Path, labrig: Labrig) -> None:
    """A file name that is not UTF-8 is listed with its bytes escaped, also in JSON."""
    assert "run-\\udcff" in labrig("runs", "--runs-dir", shelf).out
    rows = labrig("runs", "--runs-dir", shelf, "--json").json()
    assert NO_UTF_8 in {Path(row["run"]).name for row in rows}
