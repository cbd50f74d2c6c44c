"""The `labrig` command: its commands, and how every failure becomes an exit code."""

import functools
import importlib
import itertools
import math
import os
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Annotated

import typer

from labrig.cli.help_layout import HelpfulCommand, HelpfulGroup
from labrig.cli.options import complete_live
from labrig.cli.output import print_failure, print_line
from labrig.cli.signals import Interruption, raise_on_signals
from labrig.errors import BugError, DiskError, InputError, InterruptedRunError, LabrigError, MachineError

COMMANDS: Mapping[str, tuple[str, str]] = {
    "init": ("init.init", "Make a lab folder with example protocols and rig files, or bring one up to date."),
    "run": (
        "run.run",
        "Run a protocol: move, record, measure and write the report. A design moves nothing.",
    ),
    "resume": ("run.resume", "Continue a run after a crash or a stop; finished insertions are kept."),
    "pause": ("pause.pause", "Pause a run that is made in another terminal, at its next safe point."),
    "continue": ("pause.continue_", "Continue a run that is paused."),
    "replay": (
        "replay.replay",
        "Repeat a run's procedure with its recorded camera, drives, clock and operator.",
    ),
    "check": (
        "protocols.check",
        "Check whether a protocol can run on a rig, how long it takes and how much disk it needs.",
    ),
    "schema": ("protocols.schema", "Print the JSON Schema of protocol, rig or specimen files."),
    "plan": ("plan.plan", "Plan a path to a target around obstacles, or say why there is none."),
    "report": ("record.report", "Write the report page of runs again, from their newest result or another."),
    "view": ("record.view", "Make view.rrd from the record and open it in the rerun viewer."),
    "import": ("record.import_", "Turn folders of pictures into runs."),
    "reanalyze": (
        "reanalyze.reanalyze",
        "Measure the pictures of runs again and write a new numbered result.",
    ),
    "compare": (
        "compare.compare",
        "Compare runs, needles and gels: means, intervals, tests, drift, and what their errors share.",
    ),
    "export": ("export.export", "Write a run as CSV, Parquet or MATLAB, or copy its record."),
    "design": (
        "design.design",
        "Compute what to cut for a steering radius, by the paper and by our own search.",
    ),
    "campaign": (
        "campaign.campaign",
        "Repeat a protocol virtually, thousands of times, over values of its keys: one table and its page.",
    ),
    "runs": ("runs.app", "List the runs, newest first; search, check, compare and annotate them."),
    "specimens": ("specimens.app", "Blocks of gel that protocols name: their files, tracks and labels."),
    "calibrate": ("calibrate.app", "Calibrate the camera: intrinsics, plane map, tip template."),
    "measure": ("measure.app", "Measure pictures that belong to no run."),
    "devices": ("devices.app", "Check the rig, show its camera, move its axes, stop it."),
    "manual": ("manual.manual", "Open a page of the manual, or list its pages."),
}
"""Each command with its file and function (or group of commands) and its help, in the order of `labrig --help`.

Only the file of the given command is imported, so that it starts sooner; the list of commands imports none.
"""


def _print_version(wanted: bool) -> None:
    if wanted:
        from labrig import __version__

        print_line(f"labrig {__version__}")
        raise typer.Exit


def _root(
    _version: Annotated[
        bool,
        typer.Option("--version", help="Print the version and exit.", callback=_print_version, is_eager=True),
    ] = False,
) -> None:
    pass


def _make_app(arguments: Sequence[str]) -> typer.Typer:
    """Return `labrig` with the command that the arguments name; of the other commands it has only the help."""
    words = _read_completed_line() or arguments
    return make_app([word for word in words if not word.startswith("-")][:1])


def make_app(named: Collection[str]) -> typer.Typer:
    """Return `labrig` with the commands that are named; of the other commands it has only the help."""
    app = typer.Typer(
        name="labrig",
        cls=HelpfulGroup,
        help="Run needle-steering experiments from protocol files, keep a record of everything, and write the report.",
        epilog="Start with: labrig init lab; cd lab; labrig run steerability",
        no_args_is_help=True,
        pretty_exceptions_enable=False,
        context_settings={"help_option_names": ["-h", "--help"]},
    )
    app.callback()(_root)
    for name, (place, text) in COMMANDS.items():
        command = _import_command(place) if name in named else _unused
        if isinstance(command, typer.Typer):
            app.add_typer(command, name=name, help=text, cls=HelpfulGroup)
        else:
            app.command(name, help=text, cls=HelpfulCommand)(command)
    return app


def _read_completed_line() -> list[str]:
    """Return the words of the line that a shell asks to complete; none if it asks for nothing."""
    line = os.environ.get("COMP_WORDS") or os.environ.get("_TYPER_COMPLETE_ARGS", "")
    return line.split()[1:] if "_LABRIG_COMPLETE" in os.environ else []


def _import_command(place: str) -> Callable[..., object]:
    file, name = place.split(".")
    command: Callable[..., object] = getattr(importlib.import_module(f"labrig.cli.{file}"), name)
    if not isinstance(command, typer.Typer):
        return _require_finite(command)
    for info in command.registered_commands:
        info.cls = HelpfulCommand
        # The group outlives this command line; another one in the same process finds its commands wrapped already.
        if info.callback is not None and not hasattr(info.callback, "__wrapped__"):
            info.callback = _require_finite(info.callback)
    return command


def _require_finite(command: Callable[..., object]) -> Callable[..., object]:
    """Return a command that refuses NaN and infinity for any of its numbers."""

    @functools.wraps(command)
    def call(**options: object) -> object:
        for name, value in options.items():
            for number in value if isinstance(value, tuple | list) else (value,):
                if isinstance(number, float) and not math.isfinite(number):
                    raise InputError(f"--{name.replace('_', '-')} is {number}", "give a finite number")
        return command(**options)

    return call


def _unused() -> None:
    """Take the place of a command that is not imported."""


def run_command(arguments: Sequence[str]) -> int:
    """Run a command line and return its exit code: 0 to 5 or 130, as the manual lists them."""
    try:
        with raise_on_signals():
            return _invoke(arguments)
    except (Interruption, KeyboardInterrupt) as interruption:
        failure: LabrigError = InterruptedRunError(f"interrupted by {str(interruption) or 'SIGINT'}")
    except typer.TyperException as error:
        # Words that the validators of typer put before a message of its own.
        failure = InputError(error.format_message().replace("Value error, ", "", 1), _hint_at_help(arguments))
    except LabrigError as error:
        # A bug in another process comes with its traceback as a note.
        failure = (
            error.reword(error.message, _keep_traceback(error).hint) if hasattr(error, "__notes__") else error
        )
    except OSError as error:
        failure = _make_disk_error(error)
    except MemoryError:
        failure = MachineError("this computer has too little memory for that", "give it less at once")
    except Exception as error:  # noqa: BLE001 - the one place where a bug ends, with a code of its own
        failure = _keep_traceback(error)
    if failure.message:  # empty if no command was given: its help has been printed
        print_failure(failure, "--json" in arguments)
    return failure.exit_code


def _invoke(arguments: Sequence[str]) -> int:
    try:
        app = _make_app(arguments)
        status = app(args=complete_live(arguments), prog_name="labrig", standalone_mode=False)
    except typer.Exit as leaving:
        return leaving.exit_code
    except SystemExit:
        # typer exits if the reader of our output has gone, as in `labrig runs | head`: nothing is wrong.
        return 0
    return status if isinstance(status, int) else 0


def _hint_at_help(arguments: Sequence[str]) -> str:
    """Return the command that prints the help of the mistyped command."""
    words = list(itertools.takewhile(lambda word: not word.startswith("-"), arguments))
    place, _ = COMMANDS.get(words[0], ("", "")) if words else ("", "")
    command = words[: 1 + place.endswith(".app")] if place else []
    return " ".join(["see: labrig", *command, "--help"])


def _keep_traceback(error: Exception) -> BugError:
    """Write the traceback of a bug into a new file, which the returned error names."""
    from labrig.cli.bug_report import keep_traceback

    return BugError(*keep_traceback(error))


def _make_disk_error(error: OSError) -> DiskError:
    """Return an error of the operating system as a sentence that names the file, if there is one."""
    what = f"{error.filename}: " if error.filename else ""
    return DiskError(f"{what}{error.strerror or error}", "check free space and permissions")
