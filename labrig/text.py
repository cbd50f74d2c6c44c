"""How numbers and counts are printed."""

import math
from collections.abc import Sequence


def number(value: object, digits: int = 3) -> str:
    """Return a number with so many decimals, or a dash if it is unknown."""
    return f"{value:.{digits}f}" if isinstance(value, int | float) else "-"


def interval(value: object, digits: int = 2) -> str:
    """Return an interval as `low to high`, or a dash if it is unknown."""
    if isinstance(value, Sequence) and len(value) == 2:
        return f"{number(value[0], digits)} to {number(value[1], digits)}"
    return "-"


def duration(seconds: float) -> str:
    """Return a time as a person says it: 45 s, 3 min."""
    return f"{seconds:.0f} s" if seconds < 99.5 else f"{seconds / 60:.0f} min"


def format_count(count: int, noun: str) -> str:
    """Return a count with its noun, in the plural if needed."""
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"


def round_down(value: float, decimals: int) -> str:
    """Return a value that is too small, or an upper limit, rounded down, as text."""
    step = 10.0**decimals
    return f"{math.floor(value * step) / step:.{decimals}f}"


def round_up(value: float, decimals: int) -> str:
    """Return a value that is too large, rounded up, as text."""
    step = 10.0**decimals
    return f"{math.ceil(value * step) / step:.{decimals}f}"
