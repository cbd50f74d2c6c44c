"""`labrig runs log`: the events of a run in words, of a run that is being made as they come."""

from typing import Annotated

import typer

from labrig.cli.options import LocalRunArgument
from labrig.cli.output import AsJson


def log(
    run: LocalRunArgument,
    every: Annotated[
        bool, typer.Option("--all", help="Also each move of an axis and each sighting of the tip.")
    ] = False,
    follow: Annotated[
        bool, typer.Option("--follow", help="Go on until the run has ended, with events as they come.")
    ] = False,
    skip: Annotated[int, typer.Option(metavar="N", min=0, help="Leave out the first N events.")] = 0,
    as_json: AsJson = False,
) -> int:
    """Print the rig time and a sentence for each event; exit with 4 when the record is damaged."""
    from labrig.cli.event_log import follow_log, print_log
    from labrig.errors import InputError

    if not follow:
        return print_log(run, skip, every=every, as_json=as_json)
    if as_json:
        raise InputError("--json prints one document, --follow lines as they come", "leave one of them out")
    follow_log(run, skip, every=every)
    return 0
