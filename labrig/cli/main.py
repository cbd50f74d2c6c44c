"""The `labrig` command: its commands, and how every failure leaves it."""

import itertools
from collections.abc import Sequence
from typing import Annotated

import typer

from labrig import __version__
from labrig.cli import (
    calibrate,
    design,
    devices,
    exporting,
    measure,
    plan,
    protocols,
    reanalyzing,
    record,
    replay,
    resume,
    run,
    runs,
)
from labrig.cli.output import print_failure, print_line
from labrig.cli.signals import Interruption, raise_on_signals
from labrig.errors import DiskError, InputError, InterruptedRunError, LabrigError

app = typer.Typer(
    name="labrig",
    help="Run needle-steering experiments from protocol files, keep a record of everything, and write the report.",
    epilog="Start with: labrig run protocols/steerability.yaml",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
run.register(app)
resume.register(app)
replay.register(app)
protocols.register(app)
plan.register(app)
record.register(app)
reanalyzing.register(app)
exporting.register(app)
design.register(app)
app.add_typer(runs.app, name="runs")
app.add_typer(calibrate.app, name="calibrate")
app.add_typer(measure.app, name="measure")
app.add_typer(devices.app, name="devices")

GROUPS = (["runs"], ["calibrate"], ["measure"], ["devices"])


def _print_version(wanted: bool) -> None:
    if wanted:
        print_line(f"labrig {__version__}")
        raise typer.Exit


@app.callback()
def _root(
    _version: Annotated[
        bool,
        typer.Option(
            "--version", help="Print the version and leave.", callback=_print_version, is_eager=True
        ),
    ] = False,
) -> None:
    pass


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
        status = app(args=list(arguments), standalone_mode=False)
    except typer.Exit as leaving:
        return leaving.exit_code
    except SystemExit:
        # typer's answer to a reader of our output that has gone, as in `labrig runs | head`: nothing is wrong.
        return 0
    return status if isinstance(status, int) else 0


def _help_of(arguments: Sequence[str]) -> str:
    """Return the command that shows how the one that was mistyped is used."""
    commands = {command.name for command in app.registered_commands} | {
        group.name for group in app.registered_groups
    }
    words = list(itertools.takewhile(lambda word: not word.startswith("-"), arguments))
    known = words[: 1 + (words[:1] in GROUPS)] if words[:1] and words[0] in commands else []
    return " ".join(["see: labrig", *known, "--help"])


def _machine_failure(error: OSError) -> DiskError:
    """Turn what the operating system refused into a sentence; it names the file where there is one."""
    what = f"{error.filename}: " if error.filename else ""
    return DiskError(f"{what}{error.strerror or error}", "check free space and permissions")
