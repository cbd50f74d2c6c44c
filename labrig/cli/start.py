"""The entry point: handles signals and replaces missing streams before anything slow is imported."""

import os
import signal
import sys

INTERRUPTED = 130


def main() -> None:
    """Run `labrig` with the arguments of the process and exit with the documented code."""
    # Until labrig handles it, Ctrl+C ends the process without a traceback: nothing has begun.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    from labrig.cli.signals import Interruption, ignore_until_exit, raise_until_exit

    _replace_closed_streams()
    try:
        raise_until_exit()
        from labrig.cli.main import run_command

        exit_code = run_command(sys.argv[1:])
    except Interruption as interruption:
        sys.stderr.write(f"error: interrupted by {interruption}\n")
        exit_code = INTERRUPTED
    ignore_until_exit()
    _flush()
    sys.exit(exit_code)


def _replace_closed_streams() -> None:
    """Give a program started with `>&-` somewhere to write; Python sets such streams to None."""
    if sys.stdout is None:
        sys.stdout = open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115, PTH123 - open until the end
    if sys.stderr is None:
        sys.stderr = open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115, PTH123 - open until the end


def _flush() -> None:
    """Flush the output; if its reader has gone, Python would print an error at exit."""
    try:
        sys.stdout.flush()
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
