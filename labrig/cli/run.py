"""`labrig run` and `labrig resume`: run a protocol, on a rig if it needs one, and write the report."""

import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from labrig.cli.options import (
    LiveKind,
    LiveOption,
    ProtocolArgument,
    RigOption,
    RunArgument,
    RunsDirOption,
    SeedOption,
    SetOption,
    YesOption,
)
from labrig.cli.output import AsJson, say
from labrig.lab import choose_runs_dir


def run(
    protocol: ProtocolArgument,
    rig: RigOption = None,
    runs_dir: RunsDirOption = None,
    run_name: Annotated[
        str | None,
        typer.Option(
            "--run-name", metavar="NAME", help="Name of the run's folder. Default: UTC time and experiment."
        ),
    ] = None,
    seed: SeedOption = None,
    settings: SetOption = None,
    yes: YesOption = False,
    live: LiveOption = None,
    as_json: AsJson = False,
) -> int:
    """Exit with 0 when the run succeeded; the record is kept whatever happens."""
    chosen = choose_runs_dir(runs_dir)
    _refuse_taken_name(chosen.path, run_name)
    if runs_dir is None:  # before the other imports, which take a second
        say(f"running {protocol}; the record goes to {chosen.path}, {chosen.reason}")
    from labrig.library.door import make_run
    from labrig.library.sources import Sources

    sources = Sources(protocol, rig, tuple(settings or ()), seed)
    if yes:
        _remark_on_yes(sources)
    attendant = _attend(live, as_json=as_json)
    finished = make_run(sources, chosen.path, run_name, attendant=attendant, command_line=sys.argv)
    return _end(finished, live, as_json)


def _refuse_taken_name(runs_dir: Path, run_name: str | None) -> None:
    """Refuse `--run-name` before anything is said of the run if another run has the name."""
    if run_name is not None:
        from labrig.record.writer import require_free_name

        require_free_name(runs_dir, run_name)


def _remark_on_yes(sources: Any) -> None:
    """Say that `--yes` answers no question that a person is asked."""
    from labrig.cli.rigs import remark_on_yes

    description = sources.load()[1]
    if description is not None:
        remark_on_yes(description, yes=True)


def resume(
    run_path: RunArgument,
    rig: RigOption = None,
    live: LiveOption = None,
    as_json: AsJson = False,
) -> int:
    """Exit with 0 when the run succeeded; refuse a rig or calibration other than those of its start."""
    from labrig.library.resumption import resume_run

    finished = resume_run(run_path, rig, tuple(sys.argv), _attend(live, as_json=as_json))
    return _end(finished, live, as_json)


def _attend(live: LiveKind | None, *, as_json: bool) -> Any:
    """Return the person at the terminal, who may pause the run unless a program reads what it prints."""
    from labrig.cli.attendant import TerminalAttendant

    return TerminalAttendant(live, pauses=not as_json)


def _end(finished: Any, live: str | None, as_json: bool) -> int:
    """Keep the view of a run that was shown live, print how it ended, and return the exit code."""
    from labrig.cli.finished_run import print_finished
    from labrig.cli.signals import Interruption
    from labrig.errors import LabrigError
    from labrig.experiments.registry import find_run_experiment
    from labrig.library.door import open_run, view

    run = open_run(finished.path)
    if live is not None:
        say("writing view.rrd")
        try:
            view(run)
        except (LabrigError, Interruption) as error:
            say(f"note: view.rrd was not written: {error}; labrig view makes it")
    return print_finished(finished, find_run_experiment(run), as_json)
