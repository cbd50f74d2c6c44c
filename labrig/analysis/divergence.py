"""Where two results of one run part: the first number that the later one has otherwise."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from labrig.record import differing_values

Scalar = str | int | float | bool | None

# What a result says of itself, and how it was asked for, differs by itself.
_STAMP = frozenset({
    "created", "damage", "inputs", "overrides", "parent", "provenance", "schema_version", "settings",
})  # fmt: skip


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

    What was measured in single pictures is looked at first, in their order, then what was computed from it.

    Parameters
    ----------
    old, new : Mapping
        The documents of both results.
    """
    for key, before, after in differing_values(_ordered(old), _ordered(new)):
        return Divergence(key, _frame_of(key, new) or _frame_of(key, old), before, after)
    return None


def _ordered(document: Mapping[str, Any]) -> dict[str, Any]:
    said = {key: value for key, value in document.items() if key not in _STAMP}
    pictures = {key: value for key, value in said.items() if _is_of_pictures(value)}
    return {**pictures, **said}


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
