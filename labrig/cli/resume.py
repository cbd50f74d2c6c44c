"""`labrig resume`: goes on with a sweep that was interrupted."""

import sys
from pathlib import Path
from typing import Annotated

import typer

from labrig.cli.options import LocalRunArgument, RigOption
from labrig.cli.output import AsJson


def register(app: typer.Typer) -> None:
    """Add the command to `labrig`."""
    app.command("resume", help="Go on with a sweep after a crash or a stop; finished insertions are kept.")(
        resume
    )


def resume(
    run_path: LocalRunArgument,
    protocol: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Protocol file, where it has moved since.", show_default=False),
    ] = None,
    rig: RigOption = None,
    as_json: AsJson = False,
) -> int:
    """Exit with 0 when the run succeeded; refuse a protocol, rig or calibration other than the run began with."""
    from labrig.cli.finished import tell
    from labrig.cli.resuming import resume_run

    return tell(resume_run(run_path, protocol, rig, tuple(sys.argv)), as_json)
