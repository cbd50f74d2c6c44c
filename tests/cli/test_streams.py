"""Standard streams that are closed, full or without a reader, and signals: never a traceback, never a lost run."""

import io
import json
import os
import signal
import subprocess
import sys
from contextlib import redirect_stderr
from pathlib import Path

import pytest

from labrig.cli.output import say
from labrig.cli.signals import Interruption, raise_on_signals
from labrig.posix import hold_signals
from tests.cli.conftest import SMALL_SWEEP, SWEEP

LABRIG = f'"{sys.executable}" -m labrig'


def _shell(command: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(["bash", "-c", command], capture_output=True, text=True, check=False, timeout=120)


@pytest.mark.parametrize(
    ("command", "exit_code", "error"),
    [("design --help >&-", 0, ""), ("manual | true", 0, ""), ("manual >/dev/full", 3, "error: ")],
)
def test_a_standard_output_that_is_closed_unread_or_full_is_told_in_a_line(
    command: str, exit_code: int, error: str
) -> None:
    """Where nobody reads on, or it was closed, that is no error; a full device is, without a traceback."""
    done = _shell(f"{LABRIG} {command}; exit ${{PIPESTATUS[0]}}")
    assert (done.returncode, done.stderr.startswith(error), bool(done.stderr)) == (
        exit_code,
        True,
        bool(error),
    )
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize("ending", ["2>&-", "2> >(exec true)"])
def test_progress_that_nobody_can_be_told_does_not_end_a_run(ending: str, tmp_path: Path) -> None:
    """Whether standard error was closed from the start or its reader goes away, the run succeeds."""
    settings = " ".join(f"'{word}'" for word in (*SMALL_SWEEP, "--set", "insertions_per_specimen=1"))
    done = _shell(f"{LABRIG} run '{SWEEP}' --runs-dir '{tmp_path}' {settings} --json {ending}")
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

    def import_guarded() -> None:
        try:
            os.kill(os.getpid(), number)
        except ValueError:
            pytest.fail("swallowed")

    assert not issubclass(Interruption, Exception)
    with raise_on_signals(), pytest.raises(Interruption, match=number.name):
        import_guarded()


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

    def say_both() -> None:
        say("one")
        say("two")

    with (
        redirect_stderr(InterruptedStream()),
        raise_on_signals(),
        pytest.raises(Interruption, match="SIGINT"),
    ):
        say_both()


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
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60
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
