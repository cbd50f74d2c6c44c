"""A result on a terminal: sentences and tables, and the values that a comparison shows."""

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class TextTable:
    """A table for a terminal: its heads, and rows with a cell for each."""

    heads: tuple[str, ...]
    rows: tuple[tuple[object, ...], ...]


@dataclass(frozen=True)
class Summary:
    """A result in a few lines, and the values that are compared with those of another result."""

    lines: tuple[str | TextTable, ...]
    values: Mapping[str, object]
