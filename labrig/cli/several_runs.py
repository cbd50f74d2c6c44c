"""What commands do with several runs and with damaged ones: a refusal or damage of a run does not stop the others."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path

from labrig.cli.options import find_runs_dir
from labrig.cli.output import print_json, say, say_failure
from labrig.errors import InputError, LabrigError, Problem, RecordError
from labrig.lab import choose_runs_dir
from labrig.library.names import require_run_folder

Row = Mapping[str, object]
Work = tuple[Path, Callable[[], Row]]
"""A run, and what is done for it, which returns what is told of the run."""


def choose_runs(
    named: Sequence[Path] | None, where: str | None, runs_dir: Path | None, command: str
) -> list[Path]:
    """Return the runs that are named, or that fit a condition. Raises `InputError` for none, or for both ways."""
    if bool(named) == (where is not None):
        raise InputError(
            f"name the runs to {command}, or a condition" + (", not both" if named else ""),
            f'for example labrig {command} A B, or labrig {command} --where "tag=pilot"',
        )
    if named:
        folder = choose_runs_dir(runs_dir).path
        return list(dict.fromkeys(require_run_folder(run, folder) for run in named))
    from labrig.record.catalogue import list_runs

    folder = find_runs_dir(runs_dir)
    found = [summary.run for summary in list_runs(folder, where)]
    if not found:
        raise InputError(f"no run in {folder} matches {where!r}", "labrig runs lists the runs")
    return found


def report_damage(damage: Sequence[Problem | str]) -> str | None:
    """Say each damaged place, and return all of them as a sentence for --json, or None."""
    places = [place if isinstance(place, str) else f"{place.where}: {place.message}" for place in damage]
    for place in places:
        say(f"error: the record is damaged: {place}")
    return f"the record is damaged: {'; '.join(places)}" if places else None


def add_damage(row: Row, damage: Sequence[Problem | str]) -> Row:
    """Return the row of a run, not ok if its record is damaged; what could be done is done all the same."""
    reason = report_damage(damage)
    return row if reason is None else {**row, "ok": False, "reason": reason}


def note_writer(run: Path) -> None:
    """Say who is still writing a run, of which only what it holds by now was used."""
    from labrig.record.layout import run_lock
    from labrig.record.lock import read_lock_owner

    if (writer := read_lock_owner(run_lock(run))) is not None:
        say(f"note: {writer} is still writing {run}; this is what it holds by now: do it again afterwards")


def require_undamaged(run: Path, damage: Sequence[Problem], hint: str = "see: labrig runs check") -> None:
    """Refuse a damaged run. Raises `RecordError`, which names the first damaged place."""
    if damage:
        raise RecordError(f"{run} is damaged: {damage[0].where}: {damage[0].message}", hint)


def do_for_each_run(runs: Iterable[Path], work: Callable[[Path], Row], key: str | None = None) -> int:
    """Do the same work for each run, otherwise as `do_each`."""
    return do_each(((run, partial(work, run)) for run in runs), key)


def do_each(works: Iterable[Work], key: str | None = None) -> int:
    """Do the work of each run as it comes, go on after a refusal, and return the exit code of the first failure.

    `key` of a run's row names what the work makes; a refused run has none. What the iterable raises is not caught.
    """
    rows: list[Row] = []
    exit_code = 0
    for run, work in works:
        try:
            row: Row = {"run": str(run), "ok": True, **work()}
            exit_code = exit_code or (0 if row["ok"] else RecordError.exit_code)
        except LabrigError as error:
            nothing = {} if key is None else {key: None}
            row = {"run": str(run), **nothing, "ok": False, "reason": error.message}
            exit_code = exit_code or error.exit_code
            say_failure(error)
        rows.append(row)
    print_json(rows)
    return exit_code
