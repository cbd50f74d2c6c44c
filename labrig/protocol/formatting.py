"""How error messages write values and hints."""

import difflib
import json
import re
from collections.abc import Iterable, Mapping
from typing import TypeAlias

Scalar: TypeAlias = str | int | float | bool | None
KeyPath: TypeAlias = tuple[str | int, ...]
Plain: TypeAlias = Scalar | list["Plain"] | dict[str, "Plain"]

MAX_SHOWN = 60


def children(value: Plain) -> Mapping[str | int, Plain]:
    """Return the entries of a section or list by key or index; a scalar has none."""
    entries = (
        value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    )
    return dict(entries)


def show(value: Plain) -> str:
    """Return a value as JSON, shortened, with control characters escaped."""
    text = json.dumps(value, ensure_ascii=not str(value).isprintable())
    return text if len(text) <= MAX_SHOWN else f"{text[:MAX_SHOWN]}… ({len(text)} characters)"


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
