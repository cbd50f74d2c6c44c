"""How error messages write values and hints."""

import difflib
import json
import re
from collections.abc import Iterable, Mapping
from math import isfinite
from typing import TypeAlias

Scalar: TypeAlias = str | int | float | bool | None
Plain: TypeAlias = Scalar | list["Plain"] | dict[str, "Plain"]

MAX_SHOWN = 60


def children(value: Plain) -> Mapping[str | int, Plain]:
    """Return the entries of a section or list by key or index; a scalar has none."""
    entries = (
        value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    )
    return dict(entries)


def show(value: Plain) -> str:
    """Return a value in a few words: a scalar as YAML, shortened, with control characters escaped."""
    if isinstance(value, str):
        shown = value if value.isprintable() and '"' not in value else json.dumps(value)[1:-1]
        return (
            f'"{shown}"' if len(shown) <= MAX_SHOWN else f'"{shown[:MAX_SHOWN]}…" ({len(value)} characters)'
        )
    if isinstance(value, list):
        return f"a list of {len(value)}" if _size(value) > 6 else f"[{', '.join(map(show, value))}]"
    if isinstance(value, float):
        return show_number(value) + ".0" * value.is_integer()
    if isinstance(value, dict):
        return "a section (keys and values)"
    return "empty (null)" if value is None else str(value).lower()  # a boolean or a whole number


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
