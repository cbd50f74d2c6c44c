"""The `labrig` command: its commands, and how every failure leaves it."""

import importlib
import itertools
from collections.abc import Mapping, Sequence
from typing import Annotated

import typer

from labrig import __version__
from labrig.cli.output import print_failure, print_line
from labrig.cli.signals import Interruption, raise_on_signals
from labrig.errors import DiskError, InputError, InterruptedRunError, LabrigError

# Each file of commands, and the commands that it brings, in the order in which help lists them. A command line that
# begins with one of them imports its file alone, so that it starts sooner.
COMMANDS: Mapping[str, tuple[str, ...]] = {
    "run": ("run", "resume"),
    "replay": ("replay",),
    "protocols": ("check", "schema"),
    "plan": ("plan",),
    "record": ("report", "view", "import"),
    "reanalyze": ("reanalyze",),
    "export": ("export",),
    "design": ("design",),
    "runs": ("runs",),
    "calibrate": ("calibrate",),
    "measure": ("measure",),
    "devices": ("devices",),
}
GROUPS = (["runs"], ["calibrate"], ["measure"], ["devices"])


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
    """Return `labrig` with the command that the arguments begin with, or else with all of them."""
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
    asked = [file for file, commands in COMMANDS.items() if arguments and arguments[0] in commands]
    for file in asked or COMMANDS:
        importlib.import_module(f"labrig.cli.{file}").register(app)
    return app


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
    commands = set(itertools.chain.from_iterable(COMMANDS.values()))
    words = list(itertools.takewhile(lambda word: not word.startswith("-"), arguments))
    known = words[: 1 + (words[:1] in GROUPS)] if words[:1] and words[0] in commands else []
    return " ".join(["see: labrig", *known, "--help"])


def _machine_failure(error: OSError) -> DiskError:
    """Turn what the operating system refused into a sentence; it names the file where there is one."""
    what = f"{error.filename}: " if error.filename else ""
    return DiskError(f"{what}{error.strerror or error}", "check free space and permissions")
