"""The entry point: handles signals and replaces missing streams before anything slow is imported."""

import os
import signal
import sys
from typing import TextIO

BUG = 5


def main() -> None:
    """Run `labrig` with the arguments of the process and exit with the documented code."""
    # Until labrig handles it, Ctrl+C ends the process without a traceback: nothing has begun.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    # A program started with `>&-` has None for a stream.
    sys.stdout = sys.stdout or _open_nothing()
    sys.stderr = sys.stderr or _open_nothing()
    try:
        exit_code = _run_arguments()
    except Exception as error:  # noqa: BLE001 - an import that fails; `run_command` reports all that comes after
        exit_code = _report_failed_import(error)
    try:
        sys.stdout.flush()
    except OSError:  # its reader has gone: Python would print an error at exit
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    sys.exit(exit_code)


def _open_nothing() -> TextIO:
    return open(os.devnull, "w", encoding="utf-8")  # noqa: PTH123 - open until the end


def _run_arguments() -> int:
    """Run the command line of the process and return its exit code; from then on signals are ignored."""
    from labrig.cli.signals import Interruption, ignore_until_exit, raise_until_exit

    try:
        raise_until_exit()
        from labrig.cli.main import run_command

        return run_command(sys.argv[1:])
    except Interruption as interruption:
        sys.stderr.write(f"error: interrupted by {interruption}\n")
        return 130  # of InterruptedRunError, which may not be there yet
    finally:
        ignore_until_exit()


def _report_failed_import(error: Exception) -> int:
    """Report an import that failed as `run_command` reports other bugs; of labrig this needs one file only."""
    import json
    from contextlib import suppress

    from labrig.cli.bug_report import keep_traceback

    message, hint = keep_traceback(error)
    with suppress(OSError):
        if "--json" in sys.argv[1:]:
            failure = {"type": "BugError", "message": message, "hint": hint}
            sys.stdout.write(json.dumps({"error": failure}, indent=2) + "\n")
    with suppress(OSError):
        sys.stderr.write(f"error: {message}\nhint: {hint}\n")
    return BUG
