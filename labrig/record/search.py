"""Finds the runs of a folder that fit a condition. It reads their protocols, which a plain list does not."""

import os
from collections.abc import Callable, Sequence
from importlib import import_module
from pathlib import Path

from labrig.record.catalogue import FoundRun, RunSummary, read_summaries, sign_runs
from labrig.record.condition import ALWAYS_KNOWN, parse_condition, require_field
from labrig.record.layout import PROTOCOL
from labrig.record.run_index import Fields, RunIndex, ShareDone, Value, ask_index, signature_of

_SUMMARIES_SHARE = 0.25
"""Of the time that a search takes without an index."""


def find_runs(
    runs_dir: Path,
    where: str | None = None,
    sort: str | None = None,
    show: Sequence[str] = (),
    *,
    reverse: bool = False,
    progress: ShareDone = lambda _: None,
) -> list[FoundRun]:
    """Find the runs of a folder that fit a condition.

    Parameters
    ----------
    where : str or None
        The condition, as `labrig.record.condition` describes it; None: every run.
    sort : str or None
        The field to sort by, smallest first, runs without it last; None: newest first.
    show : sequence of str
        Further fields whose values are returned.
    reverse : bool
        Turn that order round; runs without the field stay last.
    progress : callable
        Told the share that is done, while runs are read that the index does not have.

    Raises
    ------
    InputError
        When the condition cannot be read, or names a field that no run has.
    """
    condition = None if where is None else parse_condition(where)
    names = [] if condition is None else [name for name, _ in condition.names]
    names = list(dict.fromkeys([*names, *([] if sort is None else [sort]), *show]))
    signatures = sign_runs(runs_dir)
    if not signatures:
        return []

    def ask(index: RunIndex) -> list[FoundRun]:
        summaries = read_summaries(
            index, runs_dir, signatures, lambda share: progress(_SUMMARIES_SHARE * share)
        )
        root = os.fspath(runs_dir)
        whole = {
            name: f"{sign} {signature_of(f'{root}/{name}', (PROTOCOL,))}" for name, sign in signatures.items()
        }
        index.refresh_leaves(
            whole,
            lambda name: _read_fields(summaries[name]),
            lambda share: progress(_SUMMARIES_SHARE + (1.0 - _SUMMARIES_SHARE) * share),
        )
        known = index.known_paths().keys() | ALWAYS_KNOWN
        if condition is not None:
            condition.require_known(known)
        if sort is not None:
            require_field(sort, known, "--sort")
        for name in show:
            require_field(name, known, "--show")
        values = index.find(names, condition)
        return [FoundRun(summary, values[name]) for name, summary in summaries.items() if name in values]

    return _in_order(ask_index(runs_dir, ask), sort, reverse)


def _in_order(found: list[FoundRun], sort: str | None, reverse: bool) -> list[FoundRun]:
    if sort is None:
        return found[::-1] if reverse else found
    having = [run for run in found if any(value is not None for value in run.fields[sort])]
    lacking = [run for run in found if all(value is None for value in run.fields[sort])]
    return sorted(having, key=lambda run: _sort_key(run.fields[sort]), reverse=reverse) + lacking


def _sort_key(values: Sequence[Value]) -> tuple[int, float, str]:
    """Order numbers before text; the first of several values counts."""
    value = next(value for value in values if value is not None)
    return (1, 0.0, value) if isinstance(value, str) else (0, float(value), "")


def _read_fields(summary: RunSummary) -> Fields:
    """Return all fields of a run that the index does not have.

    What reads them, with the reader of YAML, is loaded for the first of them: that takes as long as a search for which
    the index has everything.
    """
    read: Callable[[RunSummary], Fields] = import_module("labrig.record.fields").read_fields
    return read(summary)
