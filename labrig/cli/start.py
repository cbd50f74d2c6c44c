"""The entry point: handles signals and replaces missing streams before anything slow is imported."""

import os
import signal
import sys

INTERRUPTED = 130
BUG = 5


def main() -> None:
    """Run `labrig` with the arguments of the process and exit with the documented code."""
    # Until labrig handles it, Ctrl+C ends the process without a traceback: nothing has begun.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    _replace_closed_streams()
    try:
        exit_code = _run_arguments()
    except Exception as error:  # noqa: BLE001 - an import that fails; `run_command` reports all that comes after
        exit_code = _report_failed_import(error)
    _flush()
    sys.exit(exit_code)


def _run_arguments() -> int:
    """Run the command line of the process and return its exit code; from then on signals are ignored."""
    from labrig.cli.signals import Interruption, ignore_until_exit, raise_until_exit

    try:
        raise_until_exit()
        from labrig.cli.main import run_command

        return run_command(sys.argv[1:])
    except Interruption as interruption:
        sys.stderr.write(f"error: interrupted by {interruption}\n")
        return INTERRUPTED
    finally:
        ignore_until_exit()


def _report_failed_import(error: Exception) -> int:
    """Report an import that failed as `run_command` reports other bugs; of labrig this needs one file only."""
    import json
    from contextlib import suppress

    from labrig.cli.bug_report import keep_traceback

    message, hint = keep_traceback(error)
    if "--json" in sys.argv[1:]:
        failure = {"type": "BugError", "message": message, "hint": hint}
        with suppress(OSError):
            sys.stdout.write(json.dumps({"error": failure}, indent=2) + "\n")
    with suppress(OSError):
        sys.stderr.write(f"error: {message}\nhint: {hint}\n")
    return BUG


def _replace_closed_streams() -> None:
    """Give a program started with `>&-` somewhere to write; Python sets such streams to None."""
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: SIM115, PTH123 - open until the end


def _flush() -> None:
    """Flush the output; if its reader has gone, Python would print an error at exit."""
    try:
        sys.stdout.flush()
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
