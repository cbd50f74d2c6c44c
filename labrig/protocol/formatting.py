"""How error messages write values, limits and hints."""

import difflib
import json
import re
from collections.abc import Iterable, Mapping
from math import inf, isfinite, pi
from typing import TypeAlias

Scalar: TypeAlias = str | int | float | bool | None
Plain: TypeAlias = Scalar | list["Plain"] | dict[str, "Plain"]

MAX_SHOWN = 60

# Units that people use instead of labrig's: suffix of the key -> (unit, factor to the unit of the suffix).
UNITS: dict[str, tuple[tuple[str, float], ...]] = {
    "_mm_s": (("mm/min", 1 / 60), ("cm/s", 10.0), ("m/s", 1000.0), ("mm/s", 1.0)),
    "_mm": (("m", 1000.0), ("cm", 10.0), ("um", 1e-3), ("µm", 1e-3), ("μm", 1e-3), ("in", 25.4), ("mm", 1.0)),
    "_rad_s": (("deg/s", pi / 180), ("rpm", pi / 30), ("rad/s", 1.0)),
    "_rad": (("deg", pi / 180), ("°", pi / 180), ("rad", 1.0)),
    "_percent": (("parts of one", 100.0), ("fraction", 100.0), ("%", 1.0), ("percent", 1.0)),
    "_s": (("ms", 1e-3), ("min", 60.0), ("s", 1.0)),
}
_QUANTITY = re.compile(r"([-+]?(?:[0-9]+[.]?[0-9]*|[.][0-9]+)(?:[eE][-+]?[0-9]+)?)\s*(\S*)")
_DECIMAL_COMMA = re.compile(r"[-+]?[0-9]+,[0-9]+")


def children(value: Plain) -> Mapping[str | int, Plain]:
    """Return the entries of a section or list by key or index; a scalar has none."""
    entries = (
        value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    )
    return dict(entries)


def show(value: Plain) -> str:
    """Return a value in a few words: a scalar as YAML, shortened, with control characters escaped."""
    if isinstance(value, str):
        return _show_text(value)
    if isinstance(value, list):
        return f"a list of {len(value)}" if _size(value) > 6 else f"[{', '.join(map(show, value))}]"
    if isinstance(value, float):
        return show_number(value) + ".0" * value.is_integer()
    if isinstance(value, dict):
        return "a section (keys and values)"
    return "empty (null)" if value is None else str(value).lower()  # a boolean or a whole number


def _show_text(text: str) -> str:
    shown = text if text.isprintable() and '"' not in text else json.dumps(text)[1:-1]
    return f'"{shown}"' if len(shown) <= MAX_SHOWN else f'"{shown[:MAX_SHOWN]}…" ({len(text)} characters)'


def _size(value: Plain) -> int:
    return 1 + sum(map(_size, children(value).values()))


def show_number(value: float) -> str:
    """Return a number as text: a whole number in full, any other with six digits."""
    if not isfinite(value):
        return f"{value}".replace("inf", ".inf").replace("nan", ".nan")
    return str(int(value)) if value == int(value) and abs(value) < 1e15 else f"{value:.6g}"


def show_key(key: str | int) -> str:
    """Return a part of a key path, quoted unless it is a plain word."""
    text = str(key)
    return text if re.fullmatch(r"[\w.<>-]{1,60}", text) else show(text)


def find_closest(word: str, choices: Iterable[str]) -> str | None:
    """Return the choice that `word` probably means, or None."""
    by_folded = {choice.casefold().replace("-", "_"): choice for choice in choices}
    folded = word.strip().casefold().replace("-", "_").replace(" ", "_")
    found = difflib.get_close_matches(folded, by_folded, n=1, cutoff=0.6)
    return by_folded[found[0]] if found else None


def choice_hint(word: str, choices: Iterable[str]) -> str:
    """Return `did you mean x?` for a word close to a choice, else the choices."""
    names = tuple(choices)
    meant = find_closest(word, names)
    return f"did you mean {show_key(meant)}?" if meant else "known here: " + ", ".join(map(show_key, names))


def range_words(
    noun: str, *, above: float = -inf, least: float = -inf, below: float = inf, most: float = inf
) -> str:
    """Return `noun` with its limits in words, such as `a number above 0 and at most 10`."""
    if isfinite(least) and isfinite(most):
        return f"{noun} from {show_number(least)} to {show_number(most)}"
    bounds = (("above", above), ("at least", least), ("below", below), ("at most", most))
    limits = " and ".join(f"{word} {show_number(limit)}" for word, limit in bounds if isfinite(limit))
    return f"{noun} {limits}".rstrip()


def find_unit(key: str) -> str:
    """Return the suffix of `key` that names its unit, empty if there is none."""
    return max((suffix for suffix in UNITS if key.endswith(suffix)), key=len, default="")


def rescaled_hint(key: str, value: float, lowest: float, highest: float) -> str:
    """Return a number that is out of range converted from another unit in which it would be in range."""
    for unit, factor in UNITS.get(find_unit(key), ()):
        if factor != 1.0 and value and lowest <= value * factor <= highest:
            return f"if {show_number(value)} is meant in {unit}, write {key}: {show_number(value * factor)}"
    return ""


def number_text_hint(key: str, text: str) -> str:
    """Return how to write the number in `text`; empty if it holds none."""
    if _DECIMAL_COMMA.fullmatch(text):
        return f"write a decimal point: {text.replace(',', '.')}"
    found = _QUANTITY.fullmatch(text.strip())
    if found is None:
        return ""
    number, unit = found.groups()
    factors = dict(UNITS.get(find_unit(key), ()))
    if unit in factors:
        return f"write the number alone, the key names the unit: {show_number(float(number) * factors[unit])}"
    return f"write the number without quotes: {number}" if not unit else f"write the number alone: {number}"


def other_unit_hint(written: str, known: str, value: object) -> str:
    """Return `value` converted from the unit of `written` to the unit of `known`, if the keys differ only in it."""
    suffix = find_unit(known)
    stem = known.removesuffix(suffix)
    for unit, factor in UNITS.get(suffix, ()):
        if written == f"{stem}_{unit.replace('/', '_')}" and isinstance(value, int | float):
            return f" {show_number(value)} {unit} is {known}: {show_number(value * factor)}"
    return ""
