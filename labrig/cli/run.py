"""`labrig run` and `labrig resume`: run a protocol, on a rig if it needs one, and write the report."""

import sys
from pathlib import Path
from typing import Annotated

import typer

from labrig.cli.options import (
    LiveOption,
    LocalRunArgument,
    NoPauseOption,
    ProtocolArgument,
    QuietOption,
    RigOption,
    RunsDirOption,
    SeedOption,
    SetOption,
    VerboseOption,
    YesOption,
    choose_local_runs_dir,
)
from labrig.cli.output import AsJson, say


def run(
    protocol: ProtocolArgument,
    rig: RigOption = None,
    runs_dir: RunsDirOption = None,
    run_name: Annotated[
        str | None,
        typer.Option(
            "--run-name",
            metavar="NAME",
            help="Name of the run's folder. Default: UTC time and experiment.",
            show_default=False,
        ),
    ] = None,
    seed: SeedOption = None,
    settings: SetOption = None,
    yes: YesOption = False,
    no_pause: NoPauseOption = False,
    quiet: QuietOption = False,
    live: LiveOption = None,
    verbose: VerboseOption = False,
    as_json: AsJson = False,
) -> int:
    """Exit with 0 when the run succeeded; the record is kept whatever happens."""
    chosen = choose_local_runs_dir(runs_dir)
    from labrig.cli.sources import Sources

    sources = Sources(protocol, rig, tuple(settings or ()), seed)
    loaded = sources.load_protocol()
    _refuse_taken_name(chosen.path, run_name)
    if runs_dir is None:  # before the other imports, which take a second
        say(f"running {protocol}; the record goes to {chosen.path}, {chosen.reason}")
    from labrig.cli.finished_run import print_finished
    from labrig.cli.live import Watching
    from labrig.cli.pausing import Attention
    from labrig.cli.pipeline import RunOrder, perform
    from labrig.cli.rigs import remark_on_yes
    from labrig.cli.specimen_tracks import require_usable_specimens
    from labrig.devices.clocks import SystemClock
    from labrig.experiments.registry import find_experiment

    description = sources.load_rig(loaded)
    loaded = require_usable_specimens(loaded, description, chosen.path, SystemClock().utc())
    if description is not None:
        remark_on_yes(description, yes=yes)
    experiment = find_experiment(loaded.experiment)
    sources = sources.with_rig_file(loaded)
    attention = Attention(pauses=not (no_pause or as_json), rings=not quiet)
    order = RunOrder(
        experiment,
        loaded,
        description,
        chosen.path,
        run_name,
        tuple(sys.argv),
        sources,
        attention,
        Watching(live, verbose),
    )
    return print_finished(perform(order), experiment, as_json)


def _refuse_taken_name(runs_dir: Path, run_name: str | None) -> None:
    """Refuse `--run-name` before anything is said of the run if another run has the name."""
    if run_name is not None:
        from labrig.record.writer import require_free_name

        require_free_name(runs_dir, run_name)


def resume(
    run_path: LocalRunArgument,
    protocol: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Protocol file, if it has moved since.", show_default=False),
    ] = None,
    rig: RigOption = None,
    no_pause: NoPauseOption = False,
    quiet: QuietOption = False,
    live: LiveOption = None,
    verbose: VerboseOption = False,
    as_json: AsJson = False,
) -> int:
    """Exit with 0 when the run succeeded; refuse a protocol, rig or calibration other than those of its start."""
    from labrig.cli.live import Watching
    from labrig.cli.pausing import Attention
    from labrig.cli.resume_run import resume_and_print

    attention = Attention(pauses=not (no_pause or as_json), rings=not quiet)
    return resume_and_print(
        run_path,
        protocol,
        rig,
        tuple(sys.argv),
        attention=attention,
        watching=Watching(live, verbose),
        as_json=as_json,
    )
