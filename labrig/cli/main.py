"""The `labrig` command: its commands, and how every failure leaves it."""

import importlib
import itertools
from collections.abc import Callable, Mapping, Sequence
from typing import Annotated

import typer

from labrig import __version__
from labrig.cli.output import print_failure, print_line
from labrig.cli.signals import Interruption, raise_on_signals
from labrig.errors import DiskError, InputError, InterruptedRunError, LabrigError

COMMANDS: Mapping[str, tuple[str, str]] = {
    "run": (
        "run.run",
        "Run a protocol: move, record, measure, and write the report. A design moves nothing.",
    ),
    "resume": ("run.resume", "Go on with a sweep after a crash or a stop; finished insertions are kept."),
    "replay": (
        "replay.replay",
        "Drive a run's procedure with its recorded camera, drives, clock and operator.",
    ),
    "check": (
        "protocols.check",
        "Say whether a protocol can run on a rig, how long it takes and how much disk it needs.",
    ),
    "schema": ("protocols.schema", "Print the JSON Schema of protocol files, or of rig files."),
    "plan": ("plan.plan", "Plan a path to a target around obstacles, or say why there is none."),
    "report": ("record.report", "Write the report page of runs again, from their newest result."),
    "view": ("record.view", "Make view.rrd from the record and open it in the rerun viewer."),
    "import": ("record.import_", "Turn folders of loose pictures into runs."),
    "reanalyze": ("reanalyze.reanalyze", "Measure the pictures of runs again, into a new numbered result."),
    "export": ("export.export", "Write a run as CSV, Parquet, MATLAB or MCAP, or copy its record."),
    "design": ("design.design", "What to cut for a steering radius, by the paper and by our own search."),
    "runs": ("runs.app", "List the runs, newest first; find, check, compare and annotate them."),
    "calibrate": ("calibrate.app", "Calibrate the camera: intrinsics, plane map, template of the tip."),
    "measure": ("measure.app", "Measure loose pictures."),
    "devices": ("devices.app", "Look after the rig: check it, move its axes, stop it."),
}
"""Each command: its file and function, or group of commands, and its help, in the order of the list of commands.

The file of the command that is asked for is imported alone, so that it starts sooner, and none for the list.
"""


def _print_version(wanted: bool) -> None:
    if wanted:
        print_line(f"labrig {__version__}")
        raise typer.Exit


def _root(
    _version: Annotated[
        bool,
        typer.Option(
            "--version", help="Print the version and leave.", callback=_print_version, is_eager=True
        ),
    ] = False,
) -> None:
    pass


def _app(arguments: Sequence[str]) -> typer.Typer:
    """Return `labrig` with the command that the arguments name; of the others their help is there."""
    app = typer.Typer(
        name="labrig",
        help="Run needle-steering experiments from protocol files, keep a record of everything, and write the report.",
        epilog="Start with: labrig run protocols/steerability.yaml",
        no_args_is_help=True,
        add_completion=False,
        pretty_exceptions_enable=False,
        context_settings={"help_option_names": ["-h", "--help"]},
    )
    app.callback()(_root)
    named = next((word for word in arguments if not word.startswith("-")), None)
    for name, (place, text) in COMMANDS.items():
        command = _command(place) if name == named else _not_asked_for
        if isinstance(command, typer.Typer):
            app.add_typer(command, name=name, help=text)
        else:
            app.command(name, help=text)(command)
    return app


def _command(place: str) -> Callable[..., object]:
    file, name = place.split(".")
    command: Callable[..., object] = getattr(importlib.import_module(f"labrig.cli.{file}"), name)
    return command


def _not_asked_for() -> None:
    """Stand for a command in the list of commands."""


def run_command(arguments: Sequence[str]) -> int:
    """Run one command line and return its exit code: 0, 1, 2, 3, 4 or 130, as README lists them."""
    try:
        with raise_on_signals():
            return _invoke(arguments)
    except Interruption as interruption:
        failure: LabrigError = InterruptedRunError(f"interrupted by {interruption}")
    except typer.TyperException as error:
        failure = InputError(error.format_message(), _help_of(arguments))
    except LabrigError as error:
        failure = error
    except OSError as error:
        failure = _machine_failure(error)
    if failure.message:  # empty where no command was named: its help has been printed
        print_failure(failure, "--json" in arguments)
    return failure.exit_code


def _invoke(arguments: Sequence[str]) -> int:
    try:
        status = _app(arguments)(args=list(arguments), standalone_mode=False)
    except typer.Exit as leaving:
        return leaving.exit_code
    except SystemExit:
        # typer's answer to a reader of our output that has gone, as in `labrig runs | head`: nothing is wrong.
        return 0
    return status if isinstance(status, int) else 0


def _help_of(arguments: Sequence[str]) -> str:
    """Return the command that shows how the one that was mistyped is used."""
    words = list(itertools.takewhile(lambda word: not word.startswith("-"), arguments))
    place, _ = COMMANDS.get(words[0], ("", "")) if words else ("", "")
    known = words[: 1 + place.endswith(".app")] if place else []
    return " ".join(["see: labrig", *known, "--help"])


def _machine_failure(error: OSError) -> DiskError:
    """Turn what the operating system refused into a sentence; it names the file where there is one."""
    what = f"{error.filename}: " if error.filename else ""
    return DiskError(f"{what}{error.strerror or error}", "check free space and permissions")
