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
from tests.cli.conftest import RIG, SHORT_SWEEP, SWEEP, SweepRun, sweep_command

LABRIG = f'"{sys.executable}" -m labrig'


def _shell(command: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(["bash", "-c", command], capture_output=True, text=True, check=False, timeout=120)


def test_a_closed_standard_output_is_no_error(tmp_path: Path) -> None:
    """`labrig design --help >&-` exits with 0 and prints no error."""
    done = _shell(f"{LABRIG} design --help >&-")
    assert (done.returncode, done.stderr) == (0, "")


def test_a_closed_standard_error_does_not_keep_a_run_from_succeeding(tmp_path: Path) -> None:
    """A sweep succeeds with standard error closed from the start."""
    settings = " ".join(f"'{word}'" for word in SHORT_SWEEP)
    done = _shell(f"{LABRIG} run '{SWEEP}' --rig '{RIG}' --runs-dir '{tmp_path}' {settings} --json 2>&-")
    assert done.returncode == 0
    assert json.loads(done.stdout)["exit_status"] == "success"


def test_a_full_standard_output_is_one_line(tmp_path: Path) -> None:
    """Writing to a full device exits with 3 and a one-line error, without a traceback."""
    done = _shell(f"{LABRIG} manual >/dev/full")
    assert done.returncode == 3
    assert "Traceback" not in done.stderr
    assert "error:" in done.stderr


def test_a_reader_that_has_seen_enough_is_no_error() -> None:
    """`labrig manual | true` exits with 0 and prints no error."""
    done = _shell(f"{LABRIG} manual | true; exit ${{PIPESTATUS[0]}}")
    assert (done.returncode, done.stderr) == (0, "")


def test_a_log_that_dies_does_not_end_a_run(tmp_path: Path) -> None:
    """If the reader of the progress goes away the needle is still withdrawn, and the run succeeds."""
    command = sweep_command(RIG, tmp_path)
    reader, writer = os.pipe()
    os.close(reader)
    done = subprocess.run(
        [*command, *SHORT_SWEEP, "--json"], stdout=subprocess.PIPE, stderr=writer, check=False
    )
    os.close(writer)
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


def test_a_damaged_result_can_be_made_again(sweep: SweepRun, tmp_path: Path) -> None:
    """A damaged result is named, and `labrig reanalyze` makes a new one."""
    done = _shell(
        f"cp -r '{sweep.run}' '{tmp_path}/copy' && echo '{{' > '{tmp_path}/copy/analysis/001/result.json' && "
        f"{LABRIG} reanalyze '{tmp_path}/copy' --json"
    )
    assert done.returncode == 0
    assert json.loads(done.stdout)[0]["analysis"].endswith("002")
    assert "note:" in done.stderr
