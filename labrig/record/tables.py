"""Tables for people: a unit in every name, one number a cell."""

import re
from collections.abc import Mapping, Sequence
from typing import Any

import pandas as pd

# Names of the columns of a vector, by its unit and its number of components.
_PARTS: Mapping[tuple[str, int], tuple[str, ...]] = {
    ("mm", 2): ("y", "z"),
    ("mm", 3): ("x", "y", "z"),
    ("px", 2): ("u", "v"),
}
_INTERVAL = re.compile("(ci95|interval)_mm$")
_BUDGET = "_budget_mm"
_AXIS_UNITS: Mapping[str, str] = {"insertion": "mm", "rotation": "rad", "linear": "mm"}
_FORMULA_STARTS = ("=", "+", "-", "@", "\t", "\r")
_NUMBERS = re.compile(r"[-+]?\d+(\.\d+)?(e[-+]?\d+)?(; [-+]?\d+(\.\d+)?(e[-+]?\d+)?)*", re.ASCII)


def add_axis_units(event: Mapping[str, object]) -> dict[str, object]:
    """Return an event with the unit of its axis in the names of positions and speeds."""
    unit = _AXIS_UNITS.get(str(event.get("axis")))
    if unit is None:
        return dict(event)
    units = {"position": unit, "asked_position": unit, "speed": f"{unit}_s", "asked_speed": f"{unit}_s"}
    return {f"{key}_{units[key]}" if key in units else key: value for key, value in event.items()}


def split_vectors(table: pd.DataFrame) -> pd.DataFrame:
    """Return a table in which each component of a vector has its own column.

    `tip_mm` becomes `tip_y_mm` and `tip_z_mm` (x before them where there are three), `tip_px` `tip_u_px` and
    `tip_v_px`, `radius_ci95_mm` `radius_ci95_low_mm` and `radius_ci95_high_mm`, `error_interval_mm` `error_low_mm` and
    `error_high_mm`. Other lists stay. An error budget such as `radius_budget_mm` becomes `sigma_radius_lens_mm` and so
    on.
    """
    columns: dict[str, Any] = {}
    for name in map(str, table.columns):
        values: list[Any] = list(table[name])
        budget = next((value for value in values if isinstance(value, Mapping)), None)
        if name.endswith(_BUDGET) and budget is not None:
            parts = {f"sigma_{name.removesuffix(_BUDGET)}_{source}_mm": source for source in budget}
        else:
            parts = {part: number for number, part in enumerate(_name_parts(name, values))}
        for part, key in parts.items():
            numbers = [value[key] if isinstance(value, list | tuple | Mapping) else None for value in values]
            columns[part] = pd.Series(numbers, index=table.index, dtype="float64")
        if not parts:
            columns[name] = table[name]
    return pd.DataFrame(columns, index=table.index)


def _name_parts(name: str, values: Sequence[object]) -> list[str]:
    vectors = [value for value in values if isinstance(value, list | tuple)]
    sizes = {len(vector) for vector in vectors}
    if not vectors and _INTERVAL.search(name) and all(value is None for value in values):
        sizes = {2}  # an interval without any value has two columns too
    if len(sizes) != 1 or not all(_is_number(item) for vector in vectors for item in vector):
        return []
    stem, _, unit = name.rpartition("_")
    if _INTERVAL.search(name) and sizes == {2}:
        return [f"{stem.removesuffix('_interval')}_{end}_{unit}" for end in ("low", "high")]
    return [f"{stem}_{part}_{unit}" for part in _PARTS.get((unit, sizes.pop()), ())]


def _is_number(value: object) -> bool:
    return value is None or (isinstance(value, int | float) and not isinstance(value, bool))


def escape_formula(value: object) -> object:
    """Return a cell of a CSV file; a text that a spreadsheet would take for a formula gets an apostrophe.

    A sign begins a formula too: `-y` would be computed, and show an error. Numbers stay as they are, also several with
    semicolons between them.
    """
    if not isinstance(value, str) or not value.startswith(_FORMULA_STARTS) or _NUMBERS.fullmatch(value):
        return value
    return f"'{value}"


def encode_csv(table: pd.DataFrame) -> bytes:
    """Return a table as CSV in UTF-8; unknown values are empty."""
    return table.map(escape_formula).to_csv(index=False, lineterminator="\n").encode()


def unescape_formula(text: str) -> str:
    """Return the text of a cell that `escape_formula` wrote."""
    return text[1:] if text.startswith("'") and text[1:].startswith(_FORMULA_STARTS) else text
