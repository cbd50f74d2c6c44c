"""Does the same work for several runs; a refusal or damage of a run does not stop the others."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from labrig.cli.damage import report_damage
from labrig.cli.output import failure_lines, print_json, say
from labrig.errors import LabrigError, Problem, RecordError


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
    rows: list[dict[str, object]] = []
    nothing: dict[str, object] = {} if key is None else {key: None}
    exit_code = 0
    for path in paths:
        try:
            rows.append({"run": str(path), "ok": True, **work(path)})
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
