"""The `labrig` command: its commands, and how every failure becomes an exit code."""

import inspect
import math
import re
from collections.abc import Callable, Mapping, Sequence
from contextvars import copy_context
from functools import cache, wraps
from typing import Annotated, Any

import typer
from typer.main import get_command

from labrig.cli import (
    calibrate,
    calibrate_plane,
    campaign,
    check,
    compare,
    design,
    devices,
    export,
    import_pictures,
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
    template,
)
from labrig.cli.bug_report import keep_traceback
from labrig.cli.options import complete_live
from labrig.cli.output import SPEAKS_JSON, print_failure, print_line
from labrig.cli.signals import raise_on_signals
from labrig.errors import BugError, DiskError, InputError, InterruptedRunError, LabrigError, MachineError

_Command = Callable[..., int | None]

COMMANDS: Mapping[str, tuple[_Command, str]] = {
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
    "import": (import_pictures.import_, "Turn folders of pictures into runs."),
    "reanalyze": (reanalyze.reanalyze, "Measure the pictures of runs again."),
    "compare": (compare.compare, "Compare runs, needles and gels."),
    "export": (export.export, "Write a run as tables, or copy its record."),
    "design": (design.design, "Compute what to cut for a steering radius."),
    "campaign": (campaign.campaign, "Repeat a protocol virtually, thousands of times."),
    "specimens": (specimens.specimens, "List blocks of gel, or show the tracks in one."),
    "manual": (manual.manual, "Open the manual at a page, or list its pages."),
    "runs show": (runs.show_run, "Say what a run is, how it ended, and what happened in it."),
    "runs check": (runs.check, "Verify runs: tell what is missing, was changed or added."),
    "runs annotate": (runs.annotate, "Tag runs, add a note, or judge whether to trust them."),
    "calibrate intrinsics": (calibrate.intrinsics, "Find the lens from photographs of a board."),
    "calibrate plane": (
        calibrate_plane.plane,
        "Find the map from pixels to mm from a picture of graph paper.",
    ),
    "calibrate template": (template.template, "Cut a template of the needle's tip out of a picture."),
    "calibrate adopt": (calibrate.adopt, "Copy the calibration of a calibration run to the rig's files."),
    "measure curvature": (measure.curvature, "Measure shaft, tip and radius of curvature in each picture."),
    "measure tip": (measure.tip, "Find the needle's tip in each picture by a template."),
    "devices check": (devices.check, "Check bus, drives, camera and calibration; say what to do."),
    "devices stop": (devices.stop, "Stop every axis of the rig now, also under another labrig."),
    "devices camera": (devices.camera, "Show the camera's picture, how good it is, and what is in it."),
    "devices home": (devices.home, "Home axes after confirmation; refused with a needle in tissue."),
    "devices jog": (devices.jog, "Move one axis slowly after confirmation, to verify it."),
    "devices withdraw": (devices.withdraw, "Withdraw a needle that a run left in tissue, along its path."),
    "devices simulate": (devices.simulate, "Serve simulated EPOS2 drives to any CANopen client."),
}
"""Each command with its help, in the order of the help."""

GROUPS: Mapping[str, str] = {
    "runs": "List, search, show, check and annotate runs.",
    "calibrate": "Calibrate the camera: lens, plane map, tip template.",
    "measure": "Measure pictures that belong to no run.",
    "devices": "Check the rig, show its camera, move its axes, stop it.",
}


def make_command(function: _Command) -> _Command:
    """Return a command that takes `--json`, refuses NaN and infinity, and says when it is interrupted."""

    @wraps(function)
    def command(*, as_json: bool, **values: Any) -> int | None:  # noqa: ARG001 - `run_command` has read it
        for name, value in values.items():
            for number in value if isinstance(value, tuple | list) else (value,):
                if isinstance(number, float) and not math.isfinite(number):
                    option = name.replace("_", "-")
                    raise InputError(f"--{option} is {number}", "give a finite number")
        try:
            return function(**values)
        except KeyboardInterrupt as interruption:  # of which typer would not say a word
            raise InterruptedRunError(f"interrupted by {str(interruption) or 'SIGINT'}") from interruption

    flag = Annotated[bool, typer.Option("--json", help="Print one JSON document instead of text.")]
    signature = inspect.signature(function, eval_str=True)
    as_json = inspect.Parameter("as_json", inspect.Parameter.KEYWORD_ONLY, default=False, annotation=flag)
    parameters = [*signature.parameters.values(), as_json]
    command.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]
    return command


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
        pretty_exceptions_enable=False,
        rich_markup_mode=None,  # plain help: it starts in half the time, and cuts no name on a narrow terminal
        context_settings={"help_option_names": ["-h", "--help"]},
    )
    app.callback()(_root)
    groups = {name: typer.Typer() for name in GROUPS}
    groups["runs"].callback(invoke_without_command=True)(make_command(runs.list_))
    for name, group in groups.items():
        app.add_typer(group, name=name, help=GROUPS[name])
    for name, (function, text) in COMMANDS.items():
        *above, word = name.split()
        (groups[above[0]] if above else app).command(word, help=text)(make_command(function))
    return app


app = _make_app()


def run_command(arguments: Sequence[str], app: typer.Typer = app) -> int:
    """Run a command line and return its exit code: 0 to 5 or 130, as the manual lists them."""
    return copy_context().run(_run_command, arguments, app)  # what one command sets ends with it


def _run_command(arguments: Sequence[str], app: typer.Typer) -> int:
    SPEAKS_JSON.set("--json" in arguments)
    try:
        with raise_on_signals():
            return _invoke(app, arguments)
    except typer.TyperException as error:
        known = (name for name in (*COMMANDS, *GROUPS) if [*arguments][: len(name.split())] == name.split())
        hint = " ".join(("see: labrig", *sorted(known, key=len)[-1:], "--help"))
        if any(re.search(r"[\[{][^\]}]*$|,$", word) for word in arguments):  # a shell has cut it at a blank
            hint = "put quotes around a value with blanks"
        # The validators of typer put words before a message of its own.
        failure: LabrigError = InputError(error.format_message().replace("Value error, ", "", 1), hint)
    except LabrigError as error:
        # A bug in another process comes with its traceback as a note.
        failure = (
            error.reword(error.message, keep_traceback(error)[1]) if hasattr(error, "__notes__") else error
        )
    except OSError as error:
        what = f"{error.filename}: " if error.filename else ""
        failure = DiskError(f"{what}{error.strerror or error}", "check free space and permissions")
    except MemoryError:
        failure = MachineError("this computer has too little memory for that", "give it less at once")
    except Exception as error:  # noqa: BLE001 - the one place where a bug ends, with a code of its own
        failure = BugError(*keep_traceback(error))
    print_failure(failure)
    return failure.exit_code


# What parses and calls commands; an app would make it anew each time, from every signature.
_make_parser = cache(get_command)


def _invoke(app: typer.Typer, arguments: Sequence[str]) -> int:
    try:
        status = _make_parser(app)(complete_live(arguments) or ["--help"], "labrig", standalone_mode=False)
    except typer.Exit as leaving:
        return leaving.exit_code
    except SystemExit:
        # typer exits if the reader of our output has gone, as in `labrig runs | head`: nothing is wrong.
        return 0
    return status if isinstance(status, int) else 0
