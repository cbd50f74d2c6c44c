"""All that a run says as tables: a unit in every column's name, one value a cell, lists in tables of their own."""

import json
import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import pandas as pd

from labrig.record.annotations import Annotations
from labrig.record.reader import Run
from labrig.record.tables import split_vectors

Tables = dict[str, pd.DataFrame]
_Known = Sequence[Mapping[str, object]]

_ABOUT = ("run", "experiment", "title", "exit_status", "reason", "started", "ended", "seed", "operator")
_NOTE = ("note", "revision", "text", "by", "at")
# Where a result comes from stands in its result.json, and how a plane map was varied; rolls have a table.
_LEFT_OUT = frozenset({"schema_version", "inputs", "provenance", "rolls_rad", "deflections_mm", "variations"})


def run_tables(run: Run, result: Mapping[str, Any] | None) -> Tables:
    """Return all that a run says as tables.

    Parameters
    ----------
    result : Mapping or None
        The document of a result. Its single values become the table `result`, each list of its rows one more:
        `measurements`, `specimens`, `insertions` ...

    Returns
    -------
    dict
        `run` (one row: how it ended, and what people say of it), `notes`, `states`, `events`, `trials`, `frames`,
        `truth` where there is one, then the result's. A list in a row is a table of its own, `insertion_steps` or
        `truth_path`, whose rows say which trial they belong to.
    """
    said = run.annotations
    tables: Tables = {
        "run": _about(run, said),
        "notes": _notes(said),
        "states": run.states,
        "events": run.events,
    }
    tables |= _spread("trials", run.trials)
    tables["frames"] = run.frame_table
    if not run.truth.empty:
        tables |= _spread("truth", run.truth)
    if result is not None:
        tables |= _result_tables(result)
    return {name: _flat(split_vectors(table)) for name, table in tables.items()}


def is_unknown(value: object) -> bool:
    """Return whether a cell holds nothing."""
    return value is None or value is pd.NA or (isinstance(value, float) and math.isnan(value))


def _about(run: Run, said: Annotations) -> pd.DataFrame:
    row = {key: run.manifest.get(key) for key in _ABOUT}
    row |= {"tags": ", ".join(said.tags), "verdict": said.verdict, "verdict_reason": said.verdict_reason}
    return pd.DataFrame([row])


def _notes(said: Annotations) -> pd.DataFrame:
    rows = [[getattr(note, name) for name in _NOTE] for note in said.notes]
    return pd.DataFrame(rows, columns=list(_NOTE))


def _result_tables(document: Mapping[str, Any]) -> Tables:
    tables: Tables = {"result": pd.DataFrame([dict(_single(document, ""))])}
    for name, rows in _rows_of(document, ""):
        tables |= _spread(name, pd.DataFrame(rows))
    if "rolls_rad" in document:
        rolls = {"roll_rad": document["rolls_rad"], "deflection_mm": document["deflections_mm"]}
        tables["rolls"] = pd.DataFrame(rolls)
    return tables


def _single(document: Mapping[str, Any], path: str) -> Iterator[tuple[str, object]]:
    """Give what is neither rows nor arrays, names of nested values joined by an underscore."""
    for key, value in document.items():
        if isinstance(value, Mapping) and key not in _LEFT_OUT:
            yield from _single(value, f"{path}{key}_")
        elif key not in _LEFT_OUT and not _is_list_of(value, Mapping | list):
            yield f"{path}{key}", value


def _rows_of(document: Mapping[str, Any], path: str) -> Iterator[tuple[str, list[Mapping[str, Any]]]]:
    for key, value in document.items():
        if key in _LEFT_OUT:
            continue
        if isinstance(value, Mapping):
            yield from _rows_of(value, f"{path}{key}_")
        elif _is_list_of(value, Mapping):
            yield f"{path}{key}", value


def _spread(name: str, table: pd.DataFrame, known: _Known | None = None) -> Tables:
    """Return a table and those of the lists in its cells, `known` being what each row is part of."""
    parts = [dict[str, object]()] * len(table) if known is None else known
    lists = [
        column for column in table.columns if any(_is_list_of(one, Mapping | list) for one in table[column])
    ]
    bare = table.drop(columns=lists)
    one = name.removesuffix("s")
    keys = _keys(one, table, parts)
    tables = {name: pd.concat([pd.DataFrame(list(parts), index=table.index), bare], axis=1)}
    for column in lists:
        items = [
            (item, key)
            for cell, key in zip(table[column], keys, strict=True)
            for item in (cell if isinstance(cell, list) else ())
        ]
        rows = pd.DataFrame([item if isinstance(item, Mapping) else {column: item} for item, _ in items])
        tables |= _spread(f"{one}_{_without_unit(str(column))}", rows, [key for _, key in items])
    return tables


def _keys(one: str, table: pd.DataFrame, parts: _Known) -> list[dict[str, object]]:
    """Return what tells each row from the others of its whole: its trial, or else its number from 0."""
    if "trial" in table.columns:
        return [{**part, "trial": trial} for part, trial in zip(parts, table["trial"], strict=True)]
    seen: Counter[tuple[object, ...]] = Counter()
    keys = []
    for part in parts:
        whole = tuple(part.values())
        keys.append({**part, one.rpartition("_")[2]: seen[whole]})
        seen[whole] += 1
    return keys


def _without_unit(column: str) -> str:
    return column.removesuffix("_mm").removesuffix("_px")


def _is_list_of(value: object, kind: Any) -> bool:
    return isinstance(value, list) and bool(value) and all(isinstance(item, kind) for item in value)


def _flat(table: pd.DataFrame) -> pd.DataFrame:
    """Return a table in which every cell holds a number, a text, true, false or nothing."""
    return pd.DataFrame({str(name): _flat_column(table[name]) for name in table.columns}, index=table.index)


def _flat_column(column: "pd.Series[Any]") -> "pd.Series[Any]":
    if column.dtype != object:
        return column
    known = [value for value in column if not is_unknown(value)]
    if all(isinstance(value, bool) for value in known):
        return column.astype("boolean")
    if all(isinstance(value, int | float) for value in known):
        return column.astype("float64")
    return pd.Series(
        [None if is_unknown(v) else _text(v) for v in column], index=column.index, dtype="string"
    )


def _text(value: object) -> str:
    return value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)
