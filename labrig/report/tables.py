"""A run as tables: a unit in the name of each column, one value in each cell, lists in tables of their own."""

import json
import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import pandas as pd

from labrig.record.notes import Annotations
from labrig.record.reader import Run
from labrig.record.tables import split_vectors

Tables = dict[str, pd.DataFrame]
_Known = Sequence[Mapping[str, object]]

_ABOUT = ("run", "experiment", "title", "exit_status", "reason", "started", "ended", "seed", "operator")
_NOTE = ("text", "by", "at")
# The provenance of a result and the variations of a plane map stay in result.json; rolls have a table.
_LEFT_OUT = frozenset({"schema_version", "inputs", "provenance", "rolls_rad", "deflections_mm", "variations"})


def run_tables(run: Run, result: Mapping[str, Any] | None) -> Tables:
    """Return everything in a run as tables.

    Parameters
    ----------
    result : Mapping or None
        The document of a result. Its single values become the table `result`, each list of rows a table of its own:
        `measurements`, `specimens`, `insertions` ...

    Returns
    -------
    dict
        `run` (one row: its ending and its annotations), `notes`, `states`, `events`, `trials`, `frames`, `truth` if
        there is one, then those of the result. A list in a row becomes a table of its own, such as `insertion_steps`
        or `truth_path`, whose rows name their trial.
    """
    annotations = run.annotations
    tables: Tables = {
        "run": _make_run_table(run, annotations),
        "notes": _make_notes_table(annotations),
        "states": run.states,
        "events": run.events,
    }
    tables |= _split_lists("trials", run.trials)
    tables["frames"] = run.frame_table
    if not run.truth.empty:
        tables |= _split_lists("truth", run.truth)
    if result is not None:
        tables |= _make_result_tables(result)
    return {name: _flatten(split_vectors(table)) for name, table in tables.items()}


def is_unknown(value: object) -> bool:
    """Return whether a cell is empty."""
    return value is None or value is pd.NA or (isinstance(value, float) and math.isnan(value))


def _make_run_table(run: Run, annotations: Annotations) -> pd.DataFrame:
    row = {key: run.manifest.get(key) for key in _ABOUT}
    row |= {
        "tags": ", ".join(annotations.tags),
        "verdict": annotations.verdict,
    }
    return pd.DataFrame([row])


def _make_notes_table(annotations: Annotations) -> pd.DataFrame:
    rows = [[getattr(note, name) for name in _NOTE] for note in annotations.notes]
    return pd.DataFrame(rows, columns=list(_NOTE))


def _make_result_tables(document: Mapping[str, Any]) -> Tables:
    tables: Tables = {"result": pd.DataFrame([dict(_list_single_values(document, ""))])}
    for name, rows in _list_rows(document, ""):
        tables |= _split_lists(name, pd.DataFrame(rows))
    if "rolls_rad" in document:
        rolls = {"roll_rad": document["rolls_rad"], "deflection_mm": document["deflections_mm"]}
        tables["rolls"] = pd.DataFrame(rolls)
    return tables


def _list_single_values(document: Mapping[str, Any], path: str) -> Iterator[tuple[str, object]]:
    """Yield the values that are neither rows nor arrays; an underscore joins the names of nested values."""
    for key, value in document.items():
        if isinstance(value, Mapping) and key not in _LEFT_OUT:
            yield from _list_single_values(value, f"{path}{key}_")
        elif key not in _LEFT_OUT and not _is_list_of(value, Mapping | list):
            yield f"{path}{key}", value


def _list_rows(document: Mapping[str, Any], path: str) -> Iterator[tuple[str, list[Mapping[str, Any]]]]:
    for key, value in document.items():
        if key in _LEFT_OUT:
            continue
        if isinstance(value, Mapping):
            yield from _list_rows(value, f"{path}{key}_")
        elif _is_list_of(value, Mapping):
            yield f"{path}{key}", value


def _split_lists(name: str, table: pd.DataFrame, known: _Known | None = None) -> Tables:
    """Return a table and those of the lists in its cells; `known` identifies the whole that each row is part of."""
    parts = [dict[str, object]()] * len(table) if known is None else known
    lists = [
        column for column in table.columns if any(_is_list_of(cell, Mapping | list) for cell in table[column])
    ]
    bare = table.drop(columns=lists)
    singular = name.removesuffix("s")
    keys = _identify_rows(singular, table, parts)
    tables = {name: pd.concat([pd.DataFrame(list(parts), index=table.index), bare], axis=1)}
    for column in lists:
        items = [
            (item, key)
            for cell, key in zip(table[column], keys, strict=True)
            for item in (cell if isinstance(cell, list) else ())
        ]
        rows = pd.DataFrame([item if isinstance(item, Mapping) else {column: item} for item, _ in items])
        tables |= _split_lists(f"{singular}_{_strip_unit(str(column))}", rows, [key for _, key in items])
    return tables


def _identify_rows(singular: str, table: pd.DataFrame, parts: _Known) -> list[dict[str, object]]:
    """Return the key of each row within its whole: its trial, or else its number from 0."""
    if "trial" in table.columns:
        return [{**part, "trial": trial} for part, trial in zip(parts, table["trial"], strict=True)]
    counts: Counter[tuple[object, ...]] = Counter()
    keys = []
    for part in parts:
        whole = tuple(part.values())
        keys.append({**part, singular.rpartition("_")[2]: counts[whole]})
        counts[whole] += 1
    return keys


def _strip_unit(column: str) -> str:
    return column.removesuffix("_mm").removesuffix("_px")


def _is_list_of(value: object, kind: Any) -> bool:
    return isinstance(value, list) and bool(value) and all(isinstance(item, kind) for item in value)


def _flatten(table: pd.DataFrame) -> pd.DataFrame:
    """Return a table in which each cell is a number, a text, true, false or empty."""
    return pd.DataFrame(
        {str(name): _flatten_column(table[name]) for name in table.columns}, index=table.index
    )


def _flatten_column(column: "pd.Series[Any]") -> "pd.Series[Any]":
    if column.dtype != object:
        return column
    known = [value for value in column if not is_unknown(value)]
    if all(isinstance(value, bool) for value in known):
        return column.astype("boolean")
    if all(isinstance(value, int | float) for value in known):
        return column.astype("float64")
    return pd.Series(
        [None if is_unknown(v) else _to_text(v) for v in column], index=column.index, dtype="string"
    )


def _to_text(value: object) -> str:
    return value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)
