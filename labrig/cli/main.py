"""The `labrig` command: its commands, and how every failure becomes an exit code."""

import math
from collections.abc import Callable, Mapping, Sequence
from itertools import chain, takewhile
from typing import Annotated, Any

import typer
from typer.core import TyperCommand

from labrig.cli import (
    calibrate,
    campaign,
    check,
    compare,
    design,
    devices,
    export,
    init,
    manual,
    measure,
    pause,
    plan,
    reanalyze,
    record,
    replay,
    run,
    runs,
    specimens,
)
from labrig.cli.bug_report import keep_traceback
from labrig.cli.options import complete_live
from labrig.cli.output import print_failure, print_line
from labrig.cli.signals import Interruption, raise_on_signals
from labrig.errors import BugError, DiskError, InputError, InterruptedRunError, LabrigError, MachineError

_Command = Callable[..., object]

COMMANDS: Mapping[str, tuple[_Command | typer.Typer, str]] = {
    "init": (init.init, "Make a lab folder with example protocols and rig files."),
    "run": (run.run, "Run a protocol: move, record, measure, write the report."),
    "resume": (run.resume, "Continue a run after a crash or a stop."),
    "pause": (pause.pause, "Pause a run of another terminal at its next safe point."),
    "continue": (pause.continue_, "Continue a run that is paused."),
    "replay": (replay.replay, "Repeat a run's procedure with its recorded answers."),
    "check": (check.check, "Say whether a protocol can run, and how long it takes."),
    "plan": (plan.plan, "Plan a path to a target around obstacles."),
    "report": (record.report, "Write the report page of runs again."),
    "view": (record.view, "Show a run in the rerun viewer."),
    "import": (record.import_, "Turn folders of pictures into runs."),
    "reanalyze": (reanalyze.reanalyze, "Measure the pictures of runs again."),
    "compare": (compare.compare, "Compare runs, needles and gels."),
    "export": (export.export, "Write a run as tables, or copy its record."),
    "design": (design.design, "Compute what to cut for a steering radius."),
    "campaign": (campaign.campaign, "Repeat a protocol virtually, thousands of times."),
    "runs": (runs.app, "List, search, show, check and annotate runs."),
    "specimens": (specimens.specimens, "List blocks of gel, or show the tracks in one."),
    "calibrate": (calibrate.app, "Calibrate the camera: lens, plane map, tip template."),
    "measure": (measure.app, "Measure pictures that belong to no run."),
    "devices": (devices.app, "Check the rig, show its camera, move its axes, stop it."),
    "manual": (manual.manual, "Open the manual at a page, or list its pages."),
}
"""Each command, or group of commands, with its help, in the order of `labrig --help`."""


class FiniteCommand(TyperCommand):
    """A command that refuses NaN and infinity for any of its numbers."""

    def invoke(self, ctx: Any) -> Any:
        """Call the command. Raises `InputError` that names the option as it is typed."""
        for param in self.params:
            value = ctx.params.get(param.name or "")
            for number in value if isinstance(value, tuple | list) else (value,):
                if isinstance(number, float) and not math.isfinite(number):
                    raise InputError(f"{param.opts[0]} is {number}", "give a finite number")
        return super().invoke(ctx)


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


def _make_app() -> typer.Typer:
    app = typer.Typer(
        name="labrig",
        help="Run needle-steering experiments from protocol files, keep a record of everything, and write the report.",
        epilog="Start with: labrig init lab; cd lab; labrig run steerability",
        no_args_is_help=True,
        pretty_exceptions_enable=False,
        rich_markup_mode=None,  # plain help: it starts in half the time, and cuts no name on a narrow terminal
        context_settings={"help_option_names": ["-h", "--help"]},
    )
    app.callback()(_root)
    for name, (command, text) in COMMANDS.items():
        if isinstance(command, typer.Typer):
            for info in command.registered_commands:
                info.cls = FiniteCommand
            app.add_typer(command, name=name, help=text)
        else:
            app.command(name, help=text, cls=FiniteCommand)(command)
    return app


app = _make_app()


def run_command(arguments: Sequence[str], app: typer.Typer = app) -> int:
    """Run a command line and return its exit code: 0 to 5 or 130, as the manual lists them."""
    try:
        with raise_on_signals():
            return _invoke(app, arguments)
    except (Interruption, KeyboardInterrupt) as interruption:
        failure: LabrigError = InterruptedRunError(f"interrupted by {str(interruption) or 'SIGINT'}")
    except typer.TyperException as error:
        # Words that the validators of typer put before a message of its own.
        failure = InputError(error.format_message().replace("Value error, ", "", 1), _hint_at_help(arguments))
    except LabrigError as error:
        # A bug in another process comes with its traceback as a note.
        failure = (
            error.reword(error.message, keep_traceback(error)[1]) if hasattr(error, "__notes__") else error
        )
    except OSError as error:
        failure = _make_disk_error(error)
    except MemoryError:
        failure = MachineError("this computer has too little memory for that", "give it less at once")
    except Exception as error:  # noqa: BLE001 - the one place where a bug ends, with a code of its own
        failure = _report_bug(error)
    if failure.message:  # empty if no command was given: its help has been printed
        print_failure(failure, "--json" in arguments)
    return failure.exit_code


def _invoke(app: typer.Typer, arguments: Sequence[str]) -> int:
    try:
        status = app(args=complete_live(arguments), prog_name="labrig", standalone_mode=False)
    except typer.Exit as leaving:
        return leaving.exit_code
    except SystemExit:
        # typer exits if the reader of our output has gone, as in `labrig runs | head`: nothing is wrong.
        return 0
    return status if isinstance(status, int) else 0


def _hint_at_help(arguments: Sequence[str]) -> str:
    """Return the command that prints the help of the mistyped command."""
    group: Any = typer.main.get_command(app)
    known = []
    for word in takewhile(lambda word: not word.startswith("-"), arguments):
        group = getattr(group, "commands", {}).get(word)
        if group is None:
            break
        known.append(word)
    return " ".join(chain(["see: labrig"], known, ["--help"]))


def _report_bug(error: Exception) -> BugError:
    return BugError(*keep_traceback(error))


def _make_disk_error(error: OSError) -> DiskError:
    """Return an error of the operating system as a sentence that names the file, if there is one."""
    what = f"{error.filename}: " if error.filename else ""
    return DiskError(f"{what}{error.strerror or error}", "check free space and permissions")
