"""One thing done for each of several runs: a refusal or damage of one does not keep the others from theirs."""

from collections.abc import Callable, Sequence
from pathlib import Path

from labrig.cli.damage import tell_damage
from labrig.cli.output import failure_lines, print_json, say
from labrig.errors import LabrigError, Problem, RecordError


def undamaged(row: dict[str, object], damage: Sequence[Problem | str]) -> dict[str, object]:
    """Return the row of a run, not ok where its record is damaged; what could be done has been done all the same."""
    told = tell_damage(damage)
    return row if told is None else {**row, "ok": False, "reason": told}


def each_run(paths: list[Path], work: Callable[[Path], dict[str, object]], as_json: bool, key: str) -> int:
    """Do the work for each run and go on after a refusal; exit with the first failure's code."""
    rows: list[dict[str, object]] = []
    exit_code = 0
    for path in paths:
        try:
            rows.append({"run": str(path), "ok": True, **work(path)})
            if rows[-1]["ok"] is False:
                exit_code = exit_code or RecordError.exit_code
        except LabrigError as error:
            exit_code = exit_code or error.exit_code
            rows.append({"run": str(path), key: None, "ok": False, "reason": error.message})
            for line in failure_lines(error):
                say(line)
    if as_json:
        print_json(rows)
    return exit_code
