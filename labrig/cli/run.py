"""`labrig run` and `labrig resume`: run a protocol, on a rig if it needs one, and write the report."""

import sys
from typing import Annotated, Any

from typer import Option

from labrig.cli.options import (
    LiveKind,
    LiveOption,
    ProtocolArgument,
    RigOption,
    RunArgument,
    RunsDirOption,
    SeedOption,
    SetOption,
)
from labrig.cli.output import say
from labrig.lab import choose_runs_dir


def run(
    protocol: ProtocolArgument,
    rig: RigOption = None,
    runs_dir: RunsDirOption = None,
    run_name: Annotated[
        str | None, Option(metavar="NAME", help="Name of the run's folder. Default: UTC time and experiment.")
    ] = None,
    seed: SeedOption = None,
    settings: SetOption = None,
    yes: Annotated[
        bool, Option("--yes", help="Ask nothing on a simulated rig; a real rig asks all the same.")
    ] = False,
    live: LiveOption = None,
) -> int:
    """Exit with 0 when the run succeeded; the record is kept whatever happens."""
    chosen = choose_runs_dir(runs_dir)
    new = "" if runs_dir is None or runs_dir.is_dir() else ", a new folder"
    if runs_dir is None or new:  # before the imports, which take a second
        say(f"reading {protocol}; the record will go to {chosen.path}, {chosen.reason}{new}")
    if run_name is not None:
        from labrig.record.writer import require_free_name

        require_free_name(chosen.path, run_name)
    from labrig.cli.attendant import TerminalAttendant
    from labrig.library.door import make_run
    from labrig.library.sources import Sources

    sources = Sources(protocol, rig, tuple(settings or ()), seed)
    if yes and (description := sources.load()[1]) is not None and description.asks_person:
        say("note: --yes answers only for a simulated rig without clock: real; every question is asked")
    attendant = TerminalAttendant(live)
    return _end(make_run(sources, chosen.path, run_name, attendant=attendant), attendant, live)


def resume(run_path: RunArgument, rig: RigOption = None, live: LiveOption = None) -> int:
    """Exit with 0 when the run succeeded; refuse a rig or calibration other than those of its start."""
    from labrig.cli.attendant import TerminalAttendant
    from labrig.library.resumption import resume_run

    attendant = TerminalAttendant(live)
    return _end(resume_run(run_path, rig, tuple(sys.argv), attendant), attendant, live)


def _end(finished: Any, attendant: Any, live: LiveKind | None) -> int:
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
    code = print_finished(finished, find_run_experiment(run))
    if not finished.signal_name:
        attendant.leave_view()
    return code
