"""Text of numbers, times and lists on the pages."""

import math
from collections.abc import Iterable, Mapping, Sequence

from markupsafe import Markup, escape

from labrig.text import split_key, tell_key

UNKNOWN = "–"
_MINUS = "−"

Rows = tuple[tuple[str, str], ...]
"""Terms and their values."""


def number(value: float | None, digits: int = 2) -> str:
    """Return a number with its digits and a true minus sign; a dash if it is unknown."""
    return UNKNOWN if value is None else f"{value:.{digits}f}".replace("-", _MINUS)


def signed(value: float | None, digits: int = 3) -> str:
    """Return a difference with its sign; one that rounds to zero has none."""
    if value is None or not round(value, digits):
        return number(None if value is None else 0.0, digits)
    return f"{value:+.{digits}f}".replace("-", _MINUS)


def format_time(value: object) -> str:
    """Return a recorded time such as `2026-11-21T09:30:00+00:00` in a form for people."""
    return format_value(value).replace("T", " ").replace("+00:00", " UTC")


def interval(value: Sequence[float] | None, digits: int = 2) -> str:
    """Return an interval as `low to high`."""
    return UNKNOWN if value is None else f"{number(value[0], digits)} to {number(value[1], digits)}"


def count_decimals(
    intervals: Iterable[tuple[float, float] | None], values: Iterable[float | None], most: int = 9
) -> int:
    """Return as many decimals as the narrowest interval deserves, or a tenth of the largest value; at least two."""
    widths = [limits[1] - limits[0] for limits in intervals if limits is not None]
    largest = max((abs(value) for value in values if value is not None), default=1.0)
    least = min((width for width in widths if width > 0), default=largest / 10)
    return min(max(1 - math.floor(math.log10(least or 1.0)), 2), most)


def label_key(key: str) -> str:
    """Return a key of protocol or rig as the label of an axis."""
    name, unit = split_key(key)
    return name if unit is None else f"{name} ({unit})"


def name_settings(name: str) -> str:
    """Return `key=value, ...` in words: `replan_every_mm=5` is "replan every 5 mm"."""
    return ", ".join(tell_key(*part.split("=", 1)) if "=" in part else part for part in name.split(", "))


def flatten(value: object, path: str = "") -> list[tuple[str, str]]:
    """Return a nested document as rows: dotted key, value."""
    if isinstance(value, Mapping):
        return [
            row
            for key, inner in value.items()
            for row in flatten(inner, f"{path}.{key}" if path else str(key))
        ]
    if isinstance(value, list | tuple) and any(isinstance(item, Mapping | list | tuple) for item in value):
        return [row for i, inner in enumerate(value) for row in flatten(inner, f"{path}[{i}]")]
    if isinstance(value, list | tuple):
        return [(path, ", ".join(map(format_value, value)) or UNKNOWN)]
    return [(path, format_value(value))]


def mark_breaks(key: str) -> Markup:
    """Return a dotted key as HTML that may wrap after a dot or an underscore, but not within a word."""
    return escape(key).replace(".", Markup(".<wbr>")).replace("_", Markup("_<wbr>"))


def format_value(value: object) -> str:
    """Return a value as text: a dash for None, yes or no, six digits of a number."""
    if value is None or value == "":
        return UNKNOWN
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:.6g}".replace("-", _MINUS) if isinstance(value, float) else str(value)
