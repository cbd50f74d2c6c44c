"""Find where two results of one run diverge: the first number that differs."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from labrig.record.difference import find_differences

Scalar = str | int | float | bool | None

# Members about the result itself and its request always differ.
_STAMP = frozenset({
    "created", "damage", "inputs", "overrides", "parent", "provenance", "schema_version", "settings",
})  # fmt: skip
# Sentences repeat settings and numbers; only their presence counts.
_SENTENCES = frozenset({"cause", "reason", "unmeasured"})


@dataclass(frozen=True)
class Divergence:
    """The first value that differs.

    Attributes
    ----------
    key : str
        Dotted path in the result; items of a list by their number.
    frame : int or None
        The picture in which it was measured.
    old, new : str, int, float, bool or None
        Both values; None also if it is absent.
    """

    key: str
    frame: int | None
    old: Scalar
    new: Scalar


def find_divergence(old: Mapping[str, Any], new: Mapping[str, Any]) -> Divergence | None:
    """Return where a result differs from an older one of the same run; None if all numbers are identical.

    Values measured in single pictures are compared first, in their order, then the values computed from them. Of a
    sentence only its presence is compared.

    Parameters
    ----------
    old, new : Mapping
        Documents of both results.
    """
    for key, before, after in find_differences(_order(old), _order(new)):
        both_text = isinstance(before, str) and isinstance(after, str)
        if key.rpartition(".")[2] in _SENTENCES and both_text:
            continue
        return Divergence(key, _find_frame(key, new) or _find_frame(key, old), before, after)
    return None


def _order(document: Mapping[str, Any]) -> dict[str, Any]:
    """Return a document without its stamp; at each level the lists of pictures come first, then what has such lists."""
    members = {key: _order_nested(value) for key, value in document.items() if key not in _STAMP}
    return dict(sorted(members.items(), key=lambda item: _rank(item[1])))


def _order_nested(value: object) -> object:
    if isinstance(value, Mapping):
        return _order(value)
    return [_order_nested(item) for item in value] if isinstance(value, list | tuple) else value


def _rank(value: object) -> int:
    if _is_of_pictures(value):
        return 0
    rows = value if isinstance(value, list) else []
    within = (part for row in rows if isinstance(row, Mapping) for part in row.values())
    return 1 if any(map(_is_of_pictures, within)) else 2


def _is_of_pictures(value: object) -> bool:
    rows = value if isinstance(value, list) else []
    return bool(rows) and all(isinstance(row, Mapping) and "frame" in row for row in rows)


def _find_frame(key: str, document: Mapping[str, Any]) -> int | None:
    """Return the picture that a path is about: the `frame` of the innermost item on the path that has one."""
    found: int | None = None
    here: Any = document
    for part in key.split("."):
        if isinstance(here, Mapping):
            here = here.get(part)
        elif isinstance(here, list) and part.isdecimal() and int(part) < len(here):
            here = here[int(part)]
        else:
            return found
        if isinstance(here, Mapping) and isinstance(here.get("frame"), int):
            found = here["frame"]
    return found
