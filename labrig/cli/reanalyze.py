"""`labrig reanalyze`: measures runs again and prints the new numbers beside the old ones."""

import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from labrig.cli.options import (
    LocalRunsOrNoneArgument,
    RunsDirOption,
    WorkersOption,
    find_runs_dir,
)
from labrig.cli.output import AsJson, say
from labrig.cli.several_runs import do_each, find_matching_runs, require_runs_or_condition
from labrig.cli.signals import Interruption
from labrig.errors import WorkersError

_Work = tuple[Path, Callable[[], Mapping[str, object]]]


def reanalyze(
    run_paths: LocalRunsOrNoneArgument = None,
    where: Annotated[
        str | None,
        typer.Option(metavar="CONDITION", help="Measure the runs that fit, as for labrig runs --where."),
    ] = None,
    settings: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="KEY=VALUE",
            help="Override analysis.*, or for an insertion estimator.*, planner.*, policy.*; repeatable.",
        ),
    ] = None,
    workers: WorkersOption = None,
    runs_dir: RunsDirOption = None,
    as_json: AsJson = False,
) -> int:
    """Write RUN/analysis/NNN and print the new numbers beside the old ones; the record itself is never rewritten."""
    from labrig.cli.analyze import analyze_several
    from labrig.cli.attendant import TerminalAttendant
    from labrig.cli.result_comparison import show_result
    from labrig.library.door import reanalyze as measure

    require_runs_or_condition(run_paths or (), where, "reanalyze")
    runs = list(dict.fromkeys(run_paths or find_matching_runs(find_runs_dir(runs_dir), where)))
    overrides, command_line = tuple(settings or ()), tuple(sys.argv)
    show = partial(show_result, as_json=as_json)
    if len(runs) == 1 and workers is None:
        (run,) = runs
        alone: _Work = (
            run,
            lambda: show(run, measure(run, settings=overrides, attendant=TerminalAttendant())),
        )
        return do_each([alone], as_json, key="analysis")
    measured = 0

    def list_works() -> Iterator[_Work]:
        nonlocal measured
        outcomes = analyze_several(runs, command_line, overrides, workers)
        with closing(outcomes):
            for run, outcome in outcomes:
                measured += 1
                yield run, partial(show, run, outcome)

    try:
        return do_each(list_works(), as_json, key="analysis")
    except (Interruption, WorkersError):
        if measured:
            say(f"{measured} of {len(runs)} runs are measured; their results are kept")
        raise
