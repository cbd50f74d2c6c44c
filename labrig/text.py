"""How numbers, counts and quantities are printed."""

import math
import re
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


_QUANTITIES = {
    "true_target_error": "true error at the target",
    "target_error": "error at the target",
    "template_error": "distance by the estimate",
    "sigma_target_error_roll": "SD of the target error, by depth",
    "true_min_clearance": "true least clearance",
    "min_clearance": "least clearance",
    "worst_error": "largest error of one insertion",
    "planner radius": "planned radius",
    "out of plane heading SD": "assumed wandering out of the plane",
    "disturbances heading": "wandering of the heading",
    "disturbances out of plane": "wandering out of the plane",
    "sheath x play SD": "SD of the sheath's play out of the plane",
}
_UNITS = {
    "deg_per_root_mm": "degrees/√mm", "per_mm": "per mm",
    "mm_s": "mm/s", "rad_s": "rad/s", "mm": "mm", "px": "px", "rad": "rad", "deg": "degrees", "s": "s", "percent": "%",
}  # fmt: skip
_WITH_UNIT = re.compile(rf"(.+?)_({'|'.join(_UNITS)})")


def split_quantity(column: str) -> tuple[str, str | None]:
    """Return what a column holds in words, and its unit; None without one: `radius_mm` is ("radius", "mm")."""
    last = column.rpartition(".")[2]
    parts = _WITH_UNIT.fullmatch(last)
    row, colon, name = (parts[1] if parts else last).rpartition(": ")
    words = re.sub(r"\bsd\b", "SD", name.replace("_", " ").replace("ci95", "95 % interval"))
    words = re.sub("^sigma", "SD of the", words).replace("nis", "NIS")
    return row + colon + _QUANTITIES.get(name, words), _UNITS[parts[2]] if parts else None


def split_key(key: str) -> tuple[str, str | None]:
    """Return what a key of protocol or rig holds, and its unit: `target.position_mm.2` is "target position z", mm."""
    *above, last = key.split(".")
    place = int(last) if above and last.isdigit() else None
    name, unit = split_quantity(last if place is None else above.pop())
    row = above.pop() if len(above) > 1 and not above[-1].isidentifier() else ""
    section, its_unit = split_quantity(above[-1]) if above else ("", None)
    words = f"{section}{f' {int(row) + 1}:' if row.isdigit() else ''} {name}".lstrip()
    entry = "" if place is None else f" {'xyz'[place] if 'position' in name else place + 1}"
    return _QUANTITIES.get(words, words) + entry, unit or its_unit


def tell_value(value: object, key: str) -> str:
    """Return a value with the unit of its column or key: 2 of `radius_mm` is "2 mm"."""
    text = f"{value:g}" if isinstance(value, float) else str(value)
    return f"{text} {split_key(key)[1] or ''}".rstrip()


def tell_key(key: str, value: object) -> str:
    """Return a key with its value in words: `replan_every_mm` of 5 is "replan every 5 mm"."""
    return f"{split_key(key)[0]} {tell_value(value, key)}"
