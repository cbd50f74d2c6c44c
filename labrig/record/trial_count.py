"""How many trials of a run count as done, from the lines of its events.

It reads lines and needs no models of events, which take too long to load for a list of runs.
"""

from collections.abc import Iterable, Mapping

from labrig.record.layout import MARK_BAD, NOTE, REPEAT, SKIP, TRIAL_STOP, UNDO

COUNTED = frozenset({TRIAL_STOP, SKIP, REPEAT, MARK_BAD, NOTE, UNDO})
"""The kinds of events that `count_trials_done` reads."""


def count_trials_done(lines: Iterable[Mapping[str, object]]) -> int:
    """Return how many trials ended in success and are evaluated: nobody had them made again, or marked them as bad.

    It is `trials_done` of a manifest and of a list of runs, and agrees with `decisions.fold_decisions`.

    Parameters
    ----------
    lines : iterable of mapping
        Events in the order of the record; other kinds count for nothing.
    """
    done, decided = list[object](), list[Mapping[str, object]]()
    for line in lines:
        kind = line.get("kind")
        if kind == TRIAL_STOP and line.get("exit_status") == "success":
            done.append(line.get("trial"))
        elif kind == UNDO:
            if decided and decided[-1].get("kind") == line.get("undone"):
                decided.pop()
        elif kind in COUNTED and kind != TRIAL_STOP:
            decided.append(line)
    left_out = [line.get("trial") for line in decided if line.get("kind") in {REPEAT, MARK_BAD}]
    return sum(trial not in left_out for trial in done)
