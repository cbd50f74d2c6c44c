"""Does the same work for several runs; a refusal or damage of a run does not stop the others."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path

from labrig.cli.damage import report_damage
from labrig.cli.output import failure_lines, print_json, say
from labrig.errors import InputError, LabrigError, Problem, RecordError


def require_runs_or_condition(named: Sequence[Path], where: str | None, command: str) -> None:
    """Refuse a command line that names no runs, or runs and a condition. Raises `InputError`."""
    if bool(named) == (where is not None):
        raise InputError(
            f"name the runs to {command}, or a condition" + (", not both" if named else ""),
            f'for example labrig {command} A B, or labrig {command} --where "tag=pilot"',
        )


def find_matching_runs(runs_dir: Path, where: str | None) -> list[Path]:
    """Return the runs of a folder that fit a condition. Raises `InputError` if there are none."""
    from labrig.record.catalogue import list_runs

    found = [summary.run for summary in list_runs(runs_dir, where)]
    if not found:
        raise InputError(f"no run in {runs_dir} matches {where!r}", "labrig runs lists the runs")
    return found


def add_damage(row: dict[str, object], damage: Sequence[Problem | str]) -> dict[str, object]:
    """Return the row of a run, not ok if its record is damaged; what could be done is done all the same."""
    reason = report_damage(damage)
    return row if reason is None else {**row, "ok": False, "reason": reason}


def do_for_each_run(
    paths: list[Path], work: Callable[[Path], Mapping[str, object]], as_json: bool, key: str | None = None
) -> int:
    """Do the work for each run, go on after a refusal, and return the exit code of the first failure.

    `key` of a run's row names what the work makes; a refused run has none.
    """
    return do_each(((path, partial(work, path)) for path in paths), as_json, key)


def do_each(
    works: Iterable[tuple[Path, Callable[[], Mapping[str, object]]]], as_json: bool, key: str | None = None
) -> int:
    """Do the work of each run as it comes, otherwise as `do_for_each_run`; what the iterable raises is not caught."""
    rows: list[dict[str, object]] = []
    nothing: dict[str, object] = {} if key is None else {key: None}
    exit_code = 0
    for path, work in works:
        try:
            rows.append({"run": str(path), "ok": True, **work()})
            if rows[-1]["ok"] is False:
                exit_code = exit_code or RecordError.exit_code
        except LabrigError as error:
            exit_code = exit_code or error.exit_code
            rows.append({"run": str(path), **nothing, "ok": False, "reason": error.message})
            for line in failure_lines(error):
                say(line)
    if as_json:
        print_json(rows)
    return exit_code
