"""Where two results of one run part: the first number that the later one has otherwise."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from labrig.record.difference import find_differences

Scalar = str | int | float | bool | None

# What a result says of itself, and how it was asked for, differs by itself.
_STAMP = frozenset({
    "created", "damage", "inputs", "overrides", "parent", "provenance", "schema_version", "settings",
})  # fmt: skip
# Sentences repeat settings and numbers; whether there is one counts, and not how it reads.
_SENTENCES = frozenset({"cause", "reason", "unmeasured"})


@dataclass(frozen=True)
class Divergence:
    """The first value that differs.

    Attributes
    ----------
    key : str
        Dotted path in the result; items of a list by their number.
    frame : int or None
        The picture that it was measured in.
    old, new : str, int, float, bool or None
        Both values; None also where it is absent.
    """

    key: str
    frame: int | None
    old: Scalar
    new: Scalar


def first_divergence(old: Mapping[str, Any], new: Mapping[str, Any]) -> Divergence | None:
    """Return where a result parts from an older one of the same run; None where all numbers are identical.

    What was measured in single pictures is looked at first, in their order, then what was computed from it; of a
    sentence only whether it is there.

    Parameters
    ----------
    old, new : Mapping
        The documents of both results.
    """
    for key, before, after in find_differences(_ordered(old), _ordered(new)):
        reads_otherwise = isinstance(before, str) and isinstance(after, str)
        if key.rpartition(".")[2] in _SENTENCES and reads_otherwise:
            continue
        return Divergence(key, _frame_of(key, new) or _frame_of(key, old), before, after)
    return None


def _ordered(document: Mapping[str, Any]) -> dict[str, Any]:
    """Return a document without its stamp, what is of pictures before all else, at each level."""
    said = {key: _within(value) for key, value in document.items() if key not in _STAMP}
    return dict(sorted(said.items(), key=lambda item: not _is_of_pictures(item[1])))


def _within(value: object) -> object:
    if isinstance(value, Mapping):
        return _ordered(value)
    return [_within(one) for one in value] if isinstance(value, list | tuple) else value


def _is_of_pictures(value: object) -> bool:
    return (
        isinstance(value, list)
        and bool(value)
        and all(isinstance(one, Mapping) and "frame" in one for one in value)
    )


def _frame_of(key: str, document: Mapping[str, Any]) -> int | None:
    """Return the picture that a path leads into: the `frame` of the innermost item on the way that has one."""
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
